//! `sm2 wait`.

use nix::sys::signal::Signal;

use crate::common::{Domain, Running, listener, sm2, talker};

#[test]
fn what_is_true_already_is_not_waited_for() {
    let domain = Domain::new();
    let (_talker, node) = talker(&domain, "scan");
    let is_up = format!("node:{node} up publishers==1");
    for expressions in [
        &["topic:/scan publishers>=1 subscribers==0"][..],
        &[&is_up],
        &[
            "topic:scan publishers==1",
            "node:nobody gone",
            "service:x servers==0",
        ],
    ] {
        let waited = domain.run(&[&["wait", "--timeout", "0"], expressions].concat());
        let silent = (waited.code(), waited.stdout(), waited.stderr());
        assert_eq!(silent, (0, String::new(), String::new()), "{expressions:?}");
    }
    let answer = domain.json(&["wait", "topic:scan publishers>=1"]);
    assert_eq!(answer["met"], true);
    assert_eq!(answer["expressions"][0]["publishers"], 1);
}

#[test]
fn it_ends_when_it_becomes_true() {
    let domain = Domain::new();
    let comes = domain.start(&["wait", "topic:scan publishers>=1 subscribers>=1 links>=1"]);
    let (_talker, _) = talker(&domain, "scan");
    let (listener, node) = listener(&domain, "scan", 1);
    assert_eq!(comes.finish().code(), 0);
    let goes = domain.start(&["wait", &format!("node:{node} gone"), "--timeout", "60s"]);
    listener.signal(Signal::SIGKILL);
    assert_eq!(goes.finish().code(), 0);
}

#[test]
fn a_time_out_says_what_was_seen_last() {
    let domain = Domain::new();
    let (_talker, _) = talker(&domain, "scan");
    let vain = domain.run(&["wait", "topic:scan publishers>=2", "--timeout", "50ms"]);
    vain.failed(
        1,
        &["'topic:scan publishers>=2' is not true: 1 publisher, 0 subscribers, 0 links"],
    );
    let mistyped = domain.run(&["wait", "topic:sacn links>0", "--timeout", "0"]);
    mistyped.failed(1, &["0 links; did you mean scan?"]);
    let vain = domain.run(&["wait", "node:x", "--timeout", "10ms", "--json"]);
    vain.failed(1, &["the node is not there"]);
    let answer: serde_json::Value = serde_json::from_str(&vain.stdout()).unwrap();
    assert_eq!(answer["met"], false);
    assert_eq!(answer["expressions"][0]["up"], false);
}

#[test]
fn errors_point_at_their_place() {
    for (expression, parts) in [
        ("topic:scan", ["character 11 (the end)", "publishers>=1"]),
        (
            "topic:scan publisher>=1",
            ["character 12 (publisher>=1)", "publishers>=1"],
        ),
        ("scan publishers>=1", ["character 1 (scan)", "topic:NAME"]),
        ("topic:a//b links>0", ["character 7", "a name is segments"]),
    ] {
        let wrong = Running::start(&mut sm2(&["wait", expression])).finish();
        wrong.failed(2, &[&parts[..], &["sm2 wait --help"]].concat());
    }
    let unit = ["wait", "node:a", "--timeout", "5"];
    Running::start(&mut sm2(&unit))
        .finish()
        .failed(2, &["--timeout", "200ms"]);
    Running::start(&mut sm2(&["wait"]))
        .finish()
        .failed(2, &["EXPRESSION"]);
}

#[test]
fn it_can_be_stopped() {
    let domain = Domain::new();
    let waiting = domain.start(&["wait", "node:nobody"]);
    let itself = format!("node:sm2-wait-{}", waiting.pid());
    assert_eq!(domain.run(&["wait", &itself, "--timeout", "60s"]).code(), 0);
    waiting.signal(Signal::SIGINT);
    assert_eq!(waiting.finish().code(), 130);
}
