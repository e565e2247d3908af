use super::{Options, WORKLOADS, find};
use crate::{
    job::Read,
    peers::{PEERS, Part},
};

fn options() -> Options {
    Options {
        read: Read::Full,
        seconds: None,
        size: 1_000,
        nodes: None,
        pauses: true,
        folder: None,
        gigabytes: None,
        frame_rate: None,
    }
}

#[test]
fn every_workload_has_cases_with_labels_of_their_own() {
    for workload in WORKLOADS {
        let cases = (workload.cases)(&options());
        let labels: Vec<_> = cases.iter().map(|case| case.label()).collect();
        assert!(!labels.is_empty(), "{}", workload.name);
        for (at, label) in labels.iter().enumerate() {
            assert!(!labels[..at].contains(label), "{label} twice");
            assert!(labels.len() == 1 || !label.is_empty());
        }
        assert_eq!(find(workload.name).unwrap().name, workload.name);
    }
}

#[test]
fn the_reference_runs_every_workload() {
    for workload in WORKLOADS {
        assert!((workload.supports)(&PEERS[0]).is_ok(), "{}", workload.name);
    }
}

#[test]
fn who_drops_by_design_is_not_asked_to_lose_nothing() {
    let throughput = find("throughput").unwrap();
    for peer in PEERS.iter().filter(|peer| peer.lossy) {
        assert!((throughput.supports)(peer).is_err());
    }
}

#[test]
fn the_number_of_nodes_can_be_said() {
    let some = Options {
        nodes: Some(7),
        ..options()
    };
    let cases = (find("nodes").unwrap().cases)(&some);
    let labels: Vec<_> = cases.iter().map(|case| case.label()).collect();
    assert_eq!(labels, ["7nodes"]);
}

#[test]
fn a_one_to_one_peer_runs_pingpong_and_throughput_alone() {
    let aeron = PEERS
        .iter()
        .find(|peer| peer.part == Part::OneToOne)
        .unwrap();
    let run = WORKLOADS
        .iter()
        .filter(|workload| (workload.supports)(aeron).is_ok());
    let names: Vec<_> = run.map(|workload| workload.name).collect();
    assert_eq!(names, ["pingpong", "throughput"]);
}

#[test]
fn a_peer_in_another_language_runs_three_workloads() {
    let others: Vec<_> = PEERS
        .iter()
        .filter(|peer| peer.part == Part::OtherLanguage)
        .collect();
    assert_eq!(others.len(), 5);
    for peer in others {
        let run = WORKLOADS
            .iter()
            .filter(|workload| (workload.supports)(peer).is_ok());
        let names: Vec<_> = run.map(|workload| workload.name).collect();
        assert_eq!(
            names,
            ["fig4-max", "pingpong", "throughput"],
            "{}",
            peer.name
        );
    }
}

#[test]
fn a_recorder_runs_record_alone() {
    for recorder in PEERS.iter().filter(|peer| peer.part == Part::Record) {
        let run = WORKLOADS
            .iter()
            .filter(|workload| (workload.supports)(recorder).is_ok());
        let names: Vec<_> = run.map(|workload| workload.name).collect();
        assert_eq!(names, ["record"], "{}", recorder.name);
    }
    let record = find("record").unwrap();
    let run = PEERS.iter().filter(|peer| (record.supports)(peer).is_ok());
    let names: Vec<_> = run.map(|peer| peer.name).collect();
    let expected = [
        "sm2",
        "sm2-idle",
        "mcap-writer",
        "zenoh-shm-mcap",
        "raw-disk",
    ];
    assert_eq!(names, expected);
}

#[test]
fn a_recording_needs_a_disk() {
    let memory = Options {
        folder: Some("/dev/shm".into()),
        gigabytes: Some(0.01),
        ..options()
    };
    for name in ["record", "seek"] {
        let cases = (find(name).unwrap().cases)(&memory);
        let failure = cases[0].run(&PEERS[0]).unwrap_err().to_string();
        assert!(failure.contains("in memory"), "{failure}");
    }
}
