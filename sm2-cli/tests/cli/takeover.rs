//! Commands that run while a Manager ends and another one starts.

use std::collections::HashMap;

use nix::sys::signal::Signal;
use serde_json::Value;

use crate::common::{Domain, Running, listener, talker, until};

const GONE: &str = "the Manager is gone: links go on";
const BACK: &str = "a Manager is there again";

#[test]
fn commands_that_run_say_so_and_go_on() {
    let mut domain = Domain::new();
    let (talker, one) = talker(&domain, "scan");
    let (listener, other) = listener(&domain, "scan", 1);
    listener.await_stdout("hello");
    let hz = domain.start(&["topic", "hz", "scan", "--interval", "50ms"]);
    let watch = domain.start(&["snapshot", "--watch"]);
    let wait = domain.start(&["wait", "node:newcomer", "--timeout", "60s"]);
    watch.await_stdout("+ node sm2-wait");
    until("hz has counted", || hz.stdout().lines().count() > 2);
    let running = [&talker, &listener, &hz, &watch, &wait];

    domain.kill_manager();
    for command in running {
        command.await_stderr(GONE);
    }
    // Links and counters work without a Manager.
    let (printed, counted) = (listener.stdout().len(), hz.stdout().len());
    until("messages flow", || listener.stdout().len() > printed);
    until("hz counts", || hz.stdout().len() > counted);

    domain.start_manager();
    for command in running {
        command.await_stderr(BACK);
    }
    let linked = format!("node:{other} links==1");
    assert_eq!(
        domain
            .run(&["wait", &linked, "--timeout", "60s", "--wait-manager", "60s"])
            .code(),
        0
    );
    let why = domain.run(&["why", &one, &other]);
    assert_eq!(why.code(), 0, "{why:?}");
    let counted = hz.stdout().len();
    until("hz counts on", || hz.stdout().len() > counted);
    let _newcomer = domain.node("newcomer");
    assert_eq!(wait.finish().code(), 0);
    watch.await_stdout("+ node newcomer");
    for command in [hz, watch, listener] {
        command.signal(Signal::SIGINT);
        let finished = command.finish();
        assert_eq!(finished.code(), 0, "{finished:?}");
        let stderr = finished.stderr();
        assert_eq!(stderr.matches(GONE).count(), 1, "{stderr}");
    }
}

#[test]
fn a_manager_that_is_not_there_yet_is_waited_for() {
    let mut domain = Domain::new();
    domain.stop_manager();
    let list = domain.start(&["node", "list", "--wait-manager", "60s"]);
    let stopped = domain.start(&["node", "list", "--wait-manager", "60s"]);
    for waiting in [&list, &stopped] {
        waiting.await_stderr("waiting 60 s for a Manager at");
    }
    stopped.signal(Signal::SIGINT);
    assert_eq!(stopped.finish().code(), 130);
    domain.start_manager();
    let list = list.finish();
    assert_eq!(list.code(), 0, "{list:?}");
    assert!(list.stdout().starts_with("NODE"), "{list:?}");
}

#[test]
fn waiting_for_a_manager_has_an_end() {
    let mut domain = Domain::new();
    domain.stop_manager();
    let list = domain.run(&["topic", "list", "--wait-manager", "50ms"]);
    assert_eq!(list.code(), 1);
    assert!(list.stderr().contains("no Manager answers at"), "{list:?}");
}

#[test]
fn a_manager_that_does_not_answer_is_told_in_time() {
    let domain = Domain::new();
    domain.signal_manager(Signal::SIGSTOP);
    let list = domain.run(&["topic", "list", "--connect-timeout", "100ms"]);
    let doctor = domain.run(&["doctor", "--connect-timeout", "100ms"]);
    domain.signal_manager(Signal::SIGCONT);
    list.failed(1, &["did not answer in time", "sm2 doctor"]);
    assert_eq!(doctor.code(), 1, "{doctor:?}");
    assert!(doctor.stdout().contains("does not answer"), "{doctor:?}");
}

/// The next Manager numbers the nodes differently. Each figure stays with its node.
#[test]
fn figures_stay_those_of_their_node_when_managers_change() {
    let mut domain = Domain::new();
    let mut talkers = Vec::new();
    let hz = ["topic", "hz", "scan", "--interval", "20ms", "--json"];
    let hz = domain.start(&hz);
    for count in 1..=5 {
        let talker = [
            "topic",
            "pub",
            "scan",
            "--value",
            "\"hello\"",
            "--rate",
            "200",
        ];
        let talker = domain.start(&[&talker[..], &["--loop", "--wait", "0"]].concat());
        domain.wait_for("scan", "publishers", count);
        talkers.push(talker);
        // The second publisher starts later, so that it has published less.
        until("it counts", || reports(&hz).len() as u64 > 10 * count);
    }
    for _ in 0..4 {
        domain.kill_manager();
        domain.start_manager();
        let before = reports(&hz).len();
        until("all are counted on", || {
            let all = reports(&hz);
            let full = all
                .iter()
                .skip(before)
                .filter(|it| it.len() == talkers.len());
            full.count() > 5
        });
    }
    let all = reports(&hz);
    for talker in &talkers {
        let name = &format!("sm2-pub-{}", talker.pid());
        let counts: Vec<u64> = all.iter().filter_map(|it| it.get(name).copied()).collect();
        assert!(counts.is_sorted(), "{name}: {counts:?}");
    }
}

/// The number of messages of each publisher, from the output of `hz`.
fn reports(hz: &Running) -> Vec<HashMap<String, u64>> {
    let text = hz.stdout();
    // The last line may be incomplete.
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    let publishers = |line: &str| {
        let report: Value = serde_json::from_str(line).expect("JSON");
        let all = report["publishers"].as_array().expect("publishers").clone();
        let one = |it: Value| Some((it["node"].as_str()?.to_owned(), it["messages"].as_u64()?));
        all.into_iter().filter_map(one).collect()
    };
    whole.lines().map(publishers).collect()
}
