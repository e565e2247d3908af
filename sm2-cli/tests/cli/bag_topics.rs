//! The topics that `sm2 record`, `sm2 play` and `sm2 bag filter` use.

use nix::sys::signal::Signal;
use serde_json::Value;

use crate::bag::bag;
use crate::common::{Domain, talker, until};

/// The topics of a bag that have messages.
fn topics(file: &str) -> Vec<String> {
    let (code, info, errors) = bag(&["info", file, "--json"]);
    assert_eq!(code, 0, "{errors}");
    let info: Value = serde_json::from_str(&info).unwrap();
    let topics = info["topics"].as_array().unwrap().iter();
    let topics = topics.filter(|it| it["messages"].as_u64() > Some(0));
    topics
        .map(|it| it["name"].as_str().unwrap().to_owned())
        .collect()
}

/// Records topics that match and do not match until `expected` is in the bag.
fn record(domain: &Domain, file: &str, arguments: &[&str], expected: &[&str]) {
    let recorder = domain.start(&[&["record", "-o", file, "--sync", "5ms"], arguments].concat());
    until("the chosen topics are recorded", || {
        topics_so_far(file) == expected
    });
    recorder.signal(Signal::SIGINT);
    assert_eq!(recorder.finish().code(), 0);
    assert_eq!(topics(file), expected);
}

/// The topics of a bag that may not be there yet.
fn topics_so_far(file: &str) -> Vec<String> {
    match bag(&["info", file, "--json"]) {
        (0, ..) => topics(file),
        _ => Vec::new(),
    }
}

#[test]
fn patterns_choose_the_topics_of_a_recording_and_of_a_copy() {
    let domain = Domain::new();
    let _talkers = [
        "camera/left",
        "camera/right",
        "camera/left/raw",
        "scan",
        "imu7",
    ]
    .map(|it| talker(&domain, it));
    let path = |name: &str| domain.path(name).to_str().unwrap().to_owned();
    let all = path("all.mcap");
    record(
        &domain,
        &all,
        &["camera/**", "scan", "--regex", r"imu\d+"],
        &[
            "camera/left",
            "camera/left/raw",
            "camera/right",
            "imu7",
            "scan",
        ],
    );
    record(
        &domain,
        &path("few.mcap"),
        &["--all", "--exclude", "camera/**", "--exclude-regex", "i.*"],
        &["scan"],
    );
    let filter = |name: &str, arguments: &[&str]| {
        let to = path(name);
        let written = bag(&[&["filter", &all, "-o", &to], arguments].concat());
        assert_eq!(written.0, 0, "{written:?}");
        topics(&to)
    };
    assert_eq!(
        filter("globs.mcap", &["--topic", "camera/*", "--topic", "scan"]),
        ["camera/left", "camera/right", "scan"]
    );
    assert_eq!(
        filter("others.mcap", &["--exclude", "camera/**"]),
        ["imu7", "scan"]
    );
    // Nothing is chosen in silence that is not there.
    for (arguments, hint) in [
        (["--topic", "scam"], "did you mean scan?"),
        (["--topic", "lidar/*"], "no bag has a topic \"lidar/*\""),
    ] {
        let none = path("none.mcap");
        let refused = bag(&[&["filter", &all, "-o", &none], &arguments[..]].concat());
        assert_eq!(refused.0, 1, "{refused:?}");
        assert!(refused.2.contains(hint), "{refused:?}");
    }
    domain
        .run(&["play", &all, "--remap", "scam=scan"])
        .failed(1, &["no bag has a topic \"scam\"; did you mean scan?"]);
}

#[test]
fn a_pattern_without_topics_is_named_and_missing() {
    let domain = Domain::new();
    let _talker = talker(&domain, "camera/left");
    let file = domain.path("bag.mcap");
    let file = file.to_str().unwrap();
    let patterns = ["camera/*", "camra/*", "camera/lefd", "--regex", r"imu\d+"];
    let recorder = domain.start(&[&["record", "--json", "-o", file], &patterns[..]].concat());
    let later = "so far: it is recorded when it comes";
    let hint = "; did you mean camera/left?";
    for (text, hint) in [("camra/*", hint), ("camera/lefd", hint), (r"imu\d+", "\n")] {
        recorder.await_stderr(&format!("no publisher of {text} {later}{hint}"));
    }
    let _late = talker(&domain, "imu7");
    until("the late topic is recorded", || {
        topics_so_far(file) == ["camera/left", "imu7"]
    });
    recorder.signal(Signal::SIGINT);
    let finished = recorder.finish();
    assert_eq!(finished.code(), 1, "{finished:?}");
    let said = format!("sm2: no publisher of camra/* was there{hint}\n");
    assert!(finished.stderr().contains(&said), "{finished:?}");
    let summary: Value = serde_json::from_str(&finished.stdout()).unwrap();
    let missing = summary["missing"].as_array().unwrap().iter();
    let mut missing: Vec<_> = missing.map(|it| it["topic"].as_str().unwrap()).collect();
    missing.sort_unstable();
    assert_eq!(missing, ["camera/lefd", "camra/*"]);
    let info = bag(&["info", file]).1;
    assert!(info.contains("MISSING camra/* from "), "{info}");
    assert!(info.contains(": no topic matched"), "{info}");
}

#[test]
fn two_replays_of_one_bag_run_at_once() {
    let domain = Domain::new();
    let file = domain.path("bag.mcap");
    let file = file.to_str().unwrap();
    {
        let _talker = talker(&domain, "scan");
        record(&domain, file, &["scan"], &["scan"]);
    }
    let listeners = ["scan", "second/scan"].map(|it| {
        let listener = domain.start(&["topic", "echo", it, "--count", "1"]);
        domain.wait_for(it, "subscribers", 1);
        listener
    });
    let first = domain.start(&["play", file, "--paused"]);
    domain.wait_for("scan", "publishers", 1);
    let played = domain.run(&[
        "play",
        file,
        "--rate",
        "0",
        "--prefix",
        "second",
        "--name",
        "second",
        "--service",
        "other",
    ]);
    assert_eq!(played.code(), 0, "{played:?}");
    assert!(played.stdout().starts_with("second/scan: "), "{played:?}");
    assert_eq!(domain.run(&["play", "control", "resume"]).code(), 0);
    for listener in listeners {
        assert_eq!(listener.finish().stdout(), "hello\n");
    }
    drop(first);
}

#[test]
fn a_topic_with_another_type_is_left_out_and_named() {
    let domain = Domain::new();
    let file = domain.path("bag.mcap");
    let file = file.to_str().unwrap();
    {
        let _talkers = ["scan", "imu"].map(|it| talker(&domain, it));
        record(&domain, file, &["scan", "imu"], &["imu", "scan"]);
    }
    let node = domain.node("today");
    let _publisher = node.publisher::<u64>("imu").unwrap();
    let played = domain.run(&["play", file, "--rate", "0"]);
    assert_eq!(played.code(), 1, "{played:?}");
    let left_out = "imu: NOT PLAYED: topic imu carries u64 ";
    assert!(played.stdout().contains(left_out), "{played:?}");
    assert!(played.stdout().contains("scan: "), "{played:?}");
}
