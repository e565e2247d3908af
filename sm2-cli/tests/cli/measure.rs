//! `sm2 topic hz`, `bw`, `delay` and `loss`: their figures, and that measuring changes nothing.

use std::io::IoSlice;

use nix::sys::signal::Signal;
use serde_json::{Value, json};
use sm2_io::SeqPacket;
use sm2_proto::{
    Contract, InterfaceId, OfferedQos, TypeId,
    control::{ToManager, encode_to_manager},
    link::Fate,
};

use crate::common::{Domain, Running, cells, listener, sm2, talker, until};

/// The state of the domain, without the nodes that measure.
fn graph(domain: &Domain) -> Value {
    let snapshot = domain.json(&["snapshot"]);
    let of = |what: &str| -> Vec<Value> {
        let all = snapshot[what].as_array().unwrap().iter();
        all.map(|it| {
            let mut it = it.clone();
            let members = it.as_object_mut().unwrap();
            // The counters, which change all the time.
            members.remove("counters");
            members.remove("taken");
            it
        })
        .collect()
    };
    json!({ "interfaces": of("interfaces"), "links": of("links") })
}

/// The last line of a report.
fn last(running: &Running) -> Value {
    let stdout = running.stdout();
    serde_json::from_str(stdout.lines().last().unwrap()).unwrap()
}

/// The first report of a command that `is` accepts.
fn report_when(domain: &Domain, command: &str, is: impl Fn(&Value) -> bool) -> Value {
    let arguments = ["topic", command, "scan", "--interval", "100ms", "--json"];
    let running = domain.start(&arguments);
    let mut found = None;
    until(&format!("{command} reports what is expected"), || {
        let stdout = running.stdout();
        // The last line may be incomplete.
        let (whole, _) = stdout.rsplit_once('\n').unwrap_or_default();
        let reports = whole
            .lines()
            .map(|line| serde_json::from_str(line).unwrap());
        found = reports.into_iter().find(|report| is(report));
        found.is_some()
    });
    found.unwrap()
}

#[test]
fn looking_changes_nothing() {
    let domain = Domain::new();
    let (_talker, _) = talker(&domain, "scan");
    let (_listener, _) = listener(&domain, "scan", 1);
    let before = graph(&domain);
    assert_eq!(before["links"].as_array().unwrap().len(), 1);
    for command in ["hz", "bw", "delay", "loss"] {
        let looking = domain.start(&["topic", command, "scan", "--interval", "20ms", "--json"]);
        until("some reports are there", || {
            looking.stdout().lines().count() > 3
        });
        assert_eq!(graph(&domain), before, "during {command}");
        looking.signal(Signal::SIGINT);
        assert_eq!(looking.finish().code(), 0);
        assert_eq!(graph(&domain), before, "after {command}");
    }
    let top = domain.run(&["top", "--once", "--interval", "20ms"]);
    assert_eq!(top.code(), 0, "{top:?}");
    assert_eq!(graph(&domain), before, "after top");
}

#[test]
fn hz_counts_what_is_published() {
    let domain = Domain::new();
    let (_talker, node) = talker(&domain, "scan");
    let report = report_when(&domain, "hz", |report| {
        let publisher = &report["publishers"][0];
        publisher["hz"].as_f64() > Some(0.0) && publisher["gap_ms"].is_object()
    });
    assert_eq!(report["topic"], "scan");
    assert_eq!(report["without_counters"], json!([]));
    let publishers = report["publishers"].as_array().unwrap();
    assert_eq!(publishers.len(), 1);
    let publisher = &publishers[0];
    assert_eq!(publisher["node"], *node);
    assert!(publisher["messages"].as_u64().unwrap() > 0, "{report}");
    let gap = |what: &str| publisher["gap_ms"][what].as_f64().unwrap();
    assert!(
        gap("min") <= gap("mean") && gap("mean") <= gap("max"),
        "{report}"
    );
    assert!((1.0..=31.0).contains(&gap("count")), "{report}");

    let text = domain.run(&["topic", "hz", "/scan", "--interval", "50ms", "--count", "3"]);
    let text = text.stdout();
    let lines: Vec<_> = text.lines().collect();
    assert!(lines[0].starts_with("PUBLISHER"), "{text}");
    assert_eq!(lines.len(), 4, "{text}");
    assert!(
        lines[1..].iter().all(|line| cells(line)[0] == node),
        "{text}"
    );
}

#[test]
fn bw_knows_the_size_of_messages() {
    let domain = Domain::new();
    let (_talker, _) = talker(&domain, "scan");
    let report = report_when(&domain, "bw", |report| {
        report["publishers"][0]["mean_size_bytes"].is_number()
    });
    let publisher = &report["publishers"][0];
    assert_eq!(publisher["mean_size_bytes"], 5.0, "{report}");
    let of = |what: &str| publisher[what].as_u64().unwrap();
    assert_eq!(of("bytes"), 5 * of("messages"), "{report}");
    assert!(publisher["bytes_per_s"].as_f64().unwrap() > 0.0);
}

#[test]
fn delay_is_told_for_each_subscriber() {
    let domain = Domain::new();
    let (_talker, publisher) = talker(&domain, "scan");
    let (first, one) = listener(&domain, "scan", 1);
    let (second, other) = listener(&domain, "scan", 2);
    for listener in [&first, &second] {
        listener.await_stdout("hello");
    }
    let report = domain.json(&[
        "topic",
        "delay",
        "scan",
        "--interval",
        "20ms",
        "--count",
        "1",
    ]);
    let links = report["links"].as_array().unwrap();
    let mut subscribers: Vec<_> = links
        .iter()
        .map(|it| it["subscriber"].as_str().unwrap())
        .collect();
    subscribers.sort_unstable();
    let mut expected = [&*one, &*other];
    expected.sort_unstable();
    assert_eq!(subscribers, expected);
    for link in links {
        assert_eq!(link["publisher"], *publisher);
        let of = |what: &str| link[what].as_f64().unwrap();
        assert!(of("recent") > 0.0 && of("messages") > 0.0, "{link}");
        assert!(
            of("p50_ms") <= of("max_ms") && of("max_ms") <= of("worst_ms"),
            "{link}"
        );
        assert!(of("mean_ms") <= of("max_ms"), "{link}");
    }
}

#[test]
fn loss_adds_up() {
    let domain = Domain::new();
    let (_talker, _) = talker(&domain, "scan");
    let (listener, _) = listener(&domain, "scan", 1);
    listener.await_stdout("hello");
    // The subscriber receives nothing more, so its window is soon full.
    listener.signal(Signal::SIGSTOP);
    let loss = domain.start(&["topic", "loss", "scan", "--interval", "20ms", "--json"]);
    // On the ring lane messages are displaced in shared memory, otherwise on the sender's side.
    let displaced = |report: &Value| {
        let of = |what: &str| report["links"][0][what].as_u64();
        of("overwritten") > Some(0) || of("discarded") > Some(0)
    };
    until("messages are displaced", || {
        !loss.stdout().is_empty() && displaced(&last(&loss))
    });
    let link = &last(&loss)["links"][0];
    let of = |what: &str| link[what].as_u64().unwrap();
    let fates = Fate::ALL.map(Fate::as_str);
    assert_eq!(
        of("offered"),
        fates.into_iter().map(of).sum::<u64>() + of("in_flight"),
        "{link}"
    );
    assert!(of("delivered") > 0 && of("in_flight") > 0, "{link}");
    listener.signal(Signal::SIGCONT);
}

#[test]
fn a_topic_that_comes_later_is_waited_for() {
    let domain = Domain::new();
    for command in ["hz", "bw", "loss"] {
        let waiting = [
            "topic",
            command,
            command,
            "--count",
            "1",
            "--interval",
            "50ms",
            "--timeout",
            "60s",
            "--json",
        ];
        let waiting = domain.start(&waiting);
        waiting.await_stderr(&format!(
            "waiting for a publisher of {command} (Ctrl-C ends)"
        ));
        let (_talker, _) = talker(&domain, command);
        let finished = waiting.finish();
        assert_eq!(finished.code(), 0, "{finished:?}");
        assert_eq!(finished.stdout().lines().count(), 1, "{finished:?}");
    }
}

/// A node that declares a publisher and does nothing else, until it is dropped.
fn silent_publisher(domain: &Domain, name: &str, topic: &str) -> SeqPacket {
    let socket = SeqPacket::connect(&domain.path("sm2.sock")).unwrap();
    let data = TypeId {
        name: "bytes".parse().unwrap(),
        hash: 0,
    };
    let offer = OfferedQos::new(1);
    let topic = topic.parse().unwrap();
    let hello = ToManager::Hello {
        min_version: 1,
        max_version: 1,
        name: name.parse().unwrap(),
        resuming: false,
    };
    let declare = ToManager::Declare {
        interface: InterfaceId(1),
        contract: Contract::Publisher { topic, data, offer },
    };
    // The next frame is legal only after the answer to this one.
    socket
        .send(&[IoSlice::new(&encode_to_manager(&hello))], &[])
        .unwrap();
    let mut buffer = vec![0; 65_536];
    until("it is welcome", || socket.recv(&mut buffer).is_ok());
    socket
        .send(&[IoSlice::new(&encode_to_manager(&declare))], &[])
        .unwrap();
    socket
}

#[test]
fn a_publisher_without_counters_is_named() {
    let domain = Domain::new();
    let (_talker, _) = talker(&domain, "scan");
    let _silent = silent_publisher(&domain, "silent", "scan");
    domain.wait_for("scan", "publishers", 2);
    let hz = domain.run(&[
        "topic",
        "hz",
        "scan",
        "--interval",
        "50ms",
        "--count",
        "2",
        "--json",
    ]);
    assert_eq!(hz.code(), 0);
    let said = "sm2: node silent keeps no counters: what it does is not in these figures\n";
    assert_eq!(hz.stderr(), said);
    for line in hz.stdout().lines() {
        let report: Value = serde_json::from_str(line).unwrap();
        assert_eq!(report["without_counters"], json!(["silent"]));
        assert_eq!(report["publishers"].as_array().unwrap().len(), 1);
    }
    let snapshot = domain.json(&["snapshot"]);
    assert_eq!(snapshot["without_counters"], json!(["silent"]));
}

#[test]
fn a_mistyped_topic_has_a_hint() {
    let domain = Domain::new();
    let (_talker, _) = talker(&domain, "scan");
    let waiting = domain.start(&["topic", "hz", "sacn"]);
    waiting.await_stderr("did you mean scan?");
    waiting.signal(Signal::SIGINT);
    // Ctrl-C is the regular end of a command without --count.
    assert_eq!(waiting.finish().code(), 0);
    let counting = domain.start(&["topic", "delay", "scan", "--count", "1"]);
    counting.await_stderr("waiting for a subscriber of scan");
    counting.signal(Signal::SIGINT);
    assert_eq!(counting.finish().code(), 130);
}

#[test]
fn a_count_does_not_wait_for_ever() {
    let domain = Domain::new();
    let (_talker, _) = talker(&domain, "scan");
    let count = ["topic", "delay", "scan", "--count", "1"];
    let counting = domain.run(&[&count[..], &["--timeout", "100ms"]].concat());
    assert_eq!(counting.code(), 1, "{counting:?}");
    let said = counting.stderr();
    let expected = "sm2: no subscriber of scan in 0.1 s, so there is nothing to measure: \
                    start one, or raise --timeout\n";
    assert!(said.ends_with(expected), "{said}");
    // The limit without --timeout.
    if cfg!(feature = "slow") {
        let counting = domain.run(&count);
        assert!(counting.stderr().contains("in 10.0 s"), "{counting:?}");
    }
}

#[test]
fn wrong_units_are_refused() {
    for command in ["hz", "bw", "delay", "loss"] {
        for interval in ["5", "0s", "1 parsec", "-1s"] {
            let interval = format!("--interval={interval}");
            let wrong = Running::start(&mut sm2(&["topic", command, "a", &interval])).finish();
            wrong.failed(2, &["--interval", &format!("sm2 topic {command} --help")]);
        }
    }
}

#[test]
fn the_end_of_the_reader_is_a_quiet_end() {
    let domain = Domain::new();
    let (_talker, _) = talker(&domain, "scan");
    for command in ["hz", "loss"] {
        let shell = format!(
            "\"$0\" topic {command} scan --interval 20ms --socket \"$1\" | head -n 1; \
             exit ${{PIPESTATUS[0]}}"
        );
        let mut piped = std::process::Command::new("bash");
        piped.args(["-c", &shell, env!("CARGO_BIN_EXE_sm2")]);
        let piped = Running::start(piped.arg(domain.path("sm2.sock"))).finish();
        assert_eq!((piped.code(), piped.stderr()), (0, String::new()));
        assert_eq!(piped.stdout().lines().count(), 1);
    }
}
