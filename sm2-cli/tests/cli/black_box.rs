//! `sm2 record --last` and `sm2 record trigger`.

use std::{fs, path::Path};

use nix::sys::signal::Signal;
use serde_json::{Value, json};
use sm2_bag::{Bag, Filter};

use crate::{
    bag::{bag, counts},
    common::{Domain, Running, until},
};

/// Publishes a line of text.
fn publish(domain: &Domain, topic: &str, line: &str) {
    let from = domain.path("line");
    fs::write(&from, format!("{line}\n")).unwrap();
    let from = from.to_str().unwrap();
    let options = ["--from", from, "--lines", "--wait", "1"];
    let arguments = [&["topic", "pub", topic], &options[..]].concat();
    let finished = domain.run(&arguments);
    assert_eq!(finished.code(), 0, "{finished:?}");
}

/// Waits until standard error has a text this many times.
fn wait_for(recorder: &Running, text: &str, times: usize) {
    until(text, || recorder.stderr().matches(text).count() == times);
}

/// Waits until the files of a ring have so many messages of `chatter`, which come before the next trigger then.
fn wait_for_messages(ring: &Path, count: usize) {
    until("the messages are in the ring", || {
        let files = fs::read_dir(ring).unwrap();
        let messages = files.map(|file| {
            // A new file has no first bytes yet.
            let bag = Bag::open(&file.unwrap().path()).ok()?;
            let filter = Filter {
                topics: ["chatter".to_owned()].into(),
                ..Filter::default()
            };
            let messages = bag.messages(&filter);
            Some(messages.flatten().count())
        });
        messages.flatten().sum::<usize>() == count
    });
}

/// The reason and the messages of `chatter` of each incident.
fn incidents(output: &str) -> Vec<(String, u64)> {
    let lines = output
        .lines()
        .map(|line| serde_json::from_str(line).unwrap());
    let incident = |it: Value| {
        assert!(Path::new(it["path"].as_str().unwrap()).exists());
        assert_eq!(it["bag"]["complete"], true);
        let topics = it["bag"]["topics"].as_array().unwrap().clone();
        let mut chatter = topics.iter().filter(|it| it["name"] == "chatter");
        let messages = chatter
            .next()
            .map_or(0, |it| it["messages"].as_u64().unwrap());
        (it["reason"].as_str().unwrap().to_owned(), messages)
    };
    lines.map(incident).collect()
}

#[test]
fn a_black_box_writes_what_was_before_each_trigger() {
    let domain = Domain::new();
    let path = domain.path("out");
    let folder = path.to_str().unwrap();
    let victim = domain.start(&["topic", "echo", "nothing"]);
    let nodes = || domain.json(&["snapshot"]).to_string();
    until("the victim is there", || nodes().contains("sm2-echo-"));
    let snapshot = nodes();
    let at = snapshot.find("sm2-echo-").unwrap();
    let is_name = |it: &char| it.is_ascii_alphanumeric() || *it == '-';
    let name: String = snapshot[at..].chars().take_while(is_name).collect();
    let ring = domain.path("ring");
    let arguments = [
        "record", "chatter", "--last", "60s", "--after", "0", "-o", folder,
    ];
    let into = ["--sync", "1ms", "--ring", ring.to_str().unwrap()];
    let triggers = ["--on-message", "alarm", "--on-lost", &name];
    let absent = ["--on-lost", "nobody", "--json"];
    let recorder = domain.start(&[&arguments[..], &into, &triggers, &absent].concat());
    recorder.await_stderr("keeping the last");
    let told = recorder.stderr();
    assert_eq!(told.matches("no node").count(), 1, "{told}");
    assert!(told.contains("no node nobody is there"), "{told}");
    domain.wait_for("chatter", "subscribers", 1);
    publish(&domain, "chatter", "first");
    wait_for_messages(&ring, 1);

    let called = domain.run(&["record", "trigger", "collision"]);
    assert_eq!(called.code(), 0, "{called:?}");
    let bag = called.stdout();
    assert!(
        bag.contains("incident-") && bag.ends_with(".mcap\n"),
        "{bag}"
    );
    wait_for(&recorder, "triggered by collision", 1);

    publish(&domain, "chatter", "second");
    wait_for_messages(&ring, 2);
    recorder.signal(Signal::SIGUSR1);
    wait_for(&recorder, "triggered by SIGUSR1", 1);
    publish(&domain, "alarm", "fire");
    wait_for(&recorder, "triggered by message of alarm", 1);
    victim.signal(Signal::SIGKILL);
    victim.finish();
    wait_for(&recorder, &format!("triggered by lost node {name}"), 1);

    recorder.signal(Signal::SIGTERM);
    let finished = recorder.finish();
    assert_eq!(finished.code(), 0, "{finished:?}");
    let mut incidents = incidents(&finished.stdout());
    incidents.sort();
    let expected = [
        ("SIGUSR1".to_owned(), 2),
        ("collision".to_owned(), 1),
        (format!("lost node {name}"), 2),
        ("message of alarm".to_owned(), 2),
    ];
    assert_eq!(incidents, expected);
    assert_eq!(fs::read_dir(&path).unwrap().count(), 4);
    assert!(!ring.exists());
}

#[test]
fn a_ring_outlives_a_kill_and_the_next_recorder_takes_it_over() {
    let domain = Domain::new();
    let path = domain.path("out");
    let ring = domain.path("ring");
    let arguments = ["record", "chatter", "--last", "60s", "--sync", "1ms"];
    let (folder, ring_folder) = (path.to_str().unwrap(), ring.to_str().unwrap());
    let output = ["-o", folder, "--ring", ring_folder];
    let recorder = domain.start(&[&arguments[..], &output].concat());
    domain.wait_for("chatter", "subscribers", 1);
    publish(&domain, "chatter", "first");
    let file = ring.join("ring-0001.mcap");
    until("the message is in the ring", || {
        let (code, info, _) = bag(&["info", file.to_str().unwrap(), "--json"]);
        code == 0 && counts(&info)[0] == json!([["chatter", 1, 0]])
    });
    recorder.signal(Signal::SIGKILL);
    recorder.finish();
    assert!(file.exists());

    let called = domain.run(&["record", "trigger", "--timeout", "200ms"]);
    assert_eq!(called.code(), 1, "{called:?}");
    let error = called.stderr();
    assert!(error.contains("record/trigger"), "{error}");

    let again = domain.start(&[&arguments[..], &output, &["--after", "0", "--json"]].concat());
    again.await_stderr("keeping the last");
    let taken = domain.run(&[&arguments[..], &output].concat());
    taken.failed(1, &["another recorder uses this ring", "--ring"]);
    domain.wait_for("chatter", "subscribers", 1);
    publish(&domain, "chatter", "second");
    wait_for_messages(&ring, 2);
    let called = domain.run(&["record", "trigger", "kill"]);
    assert_eq!(called.code(), 0, "{called:?}");
    wait_for(&again, "triggered by kill", 1);
    again.signal(Signal::SIGTERM);
    let finished = again.finish();
    assert_eq!(incidents(&finished.stdout()), [("kill".to_owned(), 2)]);
    assert!(!ring.exists());
}

#[test]
fn each_black_box_has_a_ring_of_its_own() {
    let domain = Domain::new();
    let folder = domain.path("out");
    let arguments = ["record", "chatter", "--last", "60s", "-o"];
    let start = || {
        let running = domain.start(&[&arguments[..], &[folder.to_str().unwrap()]].concat());
        running.await_stderr("keeping the last");
        running
    };
    let (one, other) = (start(), start());
    assert!(folder.join("ring").is_dir() && folder.join("ring-2").is_dir());
    one.signal(Signal::SIGKILL);
    one.finish();
    let next = start();
    assert!(!folder.join("ring-3").exists(), "it takes the free ring");
    for running in [other, next] {
        running.signal(Signal::SIGTERM);
        assert_eq!(running.finish().code(), 0);
    }
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 0);
}

/// As after two boots of a board whose clock has no battery.
#[test]
fn recordings_of_one_second_have_names_of_their_own() {
    let domain = Domain::new();
    let folder = domain.path("out");
    fs::create_dir(&folder).unwrap();
    let arguments = ["record", "--all", "--seconds", "0.1", "-o"];
    let start = |_| domain.start(&[&arguments[..], &[folder.to_str().unwrap()]].concat());
    let recorders: Vec<_> = (0..4).map(start).collect();
    for recorder in recorders {
        let finished = recorder.finish();
        assert_eq!(finished.code(), 0, "{finished:?}");
    }
    assert_eq!(fs::read_dir(&folder).unwrap().count(), 4);
}

#[test]
fn a_black_box_has_no_other_limits() {
    let domain = Domain::new();
    for arguments in [
        &["record", "--all", "--last", "1s", "--split-size", "1MB"][..],
        &["record", "--all", "--on-message", "alarm"],
        &["record", "--all", "--last", "1s", "--on-deadline", "scan"],
    ] {
        let finished = domain.run(arguments);
        assert_eq!(finished.code(), 2, "{arguments:?}: {finished:?}");
    }
}

/// Every process of the domain can trigger, with any text.
#[test]
fn the_reason_of_a_trigger_cannot_command_the_terminal() {
    let domain = Domain::new();
    let folder = domain.path("out");
    let folder = folder.to_str().unwrap();
    let recorder = domain.start(&[
        "record", "--last", "10s", "--after", "0s", "--all", "-o", folder,
    ]);
    recorder.await_stderr("keeping the last");
    let triggered = domain.run(&["record", "trigger", "a\u{1b}[2J\u{9b}\u{202e}b"]);
    assert_eq!(triggered.code(), 0, "{triggered:?}");
    recorder.await_stderr("triggered by a\\u{1b}[2J\\u{9b}\\u{202e}b: ");
    recorder.signal(Signal::SIGINT);
    assert!(
        !recorder
            .finish()
            .stderr()
            .contains(['\u{1b}', '\u{9b}', '\u{202e}'])
    );
}
