use super::{Options, WORKLOADS, find};
use crate::{job::Read, peers::PEERS};

fn options() -> Options {
    Options {
        read: Read::Full,
        seconds: None,
        size: 1_000,
        nodes: None,
        pauses: true,
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
    let aeron = PEERS.iter().find(|peer| peer.one_to_one).unwrap();
    let run = WORKLOADS
        .iter()
        .filter(|workload| (workload.supports)(aeron).is_ok());
    let names: Vec<_> = run.map(|workload| workload.name).collect();
    assert_eq!(names, ["pingpong", "throughput"]);
}
