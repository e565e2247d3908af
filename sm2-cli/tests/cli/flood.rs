//! A flood of topics: the recorder goes on with those that it has.

use std::{
    fs,
    process::{Command, Stdio},
};

use nix::sys::signal::Signal;
use serde_json::Value;
use sm2_node::{Node, Publisher};
use sm2_test_support::ran_alone;

use crate::{
    bag::bag,
    common::{Domain, Running, SOON},
};

/// How many messages there are before the flood, in it, and after it.
const MESSAGES: u64 = 100;

/// A command that has so many descriptors: the soft and the hard limit.
fn limited(domain: &Domain, soft: u64, hard: u64, arguments: &[&str]) -> Command {
    let command = domain.command(arguments);
    let mut shell = Command::new("sh");
    let script = format!("ulimit -Sn {soft} && ulimit -Hn {hard} && exec \"$0\" \"$@\"");
    shell.args(["-c", &script]);
    shell.arg(command.get_program()).args(command.get_args());
    shell.current_dir(domain.path("")).stdin(Stdio::null());
    for (name, value) in command.get_envs() {
        match value {
            Some(value) => shell.env(name, value),
            None => shell.env_remove(name),
        };
    }
    shell
}

/// A publisher whose messages are not lost.
fn reliable(node: &Node, topic: &str) -> Publisher<u64> {
    let publisher = node.publisher_builder(topic).reliable(true);
    let publisher = publisher.publish_timeout(SOON).wait_share_percent(100);
    publisher.declare().unwrap()
}

/// Declares topics that a recorder of all topics finds.
fn flood(node: &Node, count: u32) -> Vec<Publisher<u64>> {
    let topics = 0..count;
    let publishers = topics.map(|it| reliable(node, &format!("flood/{it}")));
    publishers.collect()
}

/// Ends a recording, which must succeed. Returns its summary.
fn end(recorder: Running) -> Value {
    recorder.signal(Signal::SIGINT);
    let finished = recorder.finish();
    assert_eq!(finished.code(), 0, "{finished:?}");
    serde_json::from_str(&finished.stdout()).unwrap()
}

#[test]
fn a_recorder_without_descriptors_for_new_topics_goes_on_with_the_others() {
    const PATH: &str = concat!(
        module_path!(),
        "::a_recorder_without_descriptors_for_new_topics_goes_on_with_the_others"
    );
    if ran_alone(PATH) {
        return;
    }
    let domain = Domain::new();
    let folder = domain.path("bags");
    let record = ["record", "--all", "--reliable", "honest", "--json"];
    let output = ["-o", folder.to_str().unwrap(), "--split-size", "100"];
    let arguments = [&record[..], &output].concat();
    let recorder = Running::start(&mut limited(&domain, 64, 256, &arguments));
    recorder.await_stderr("recording to");
    let (honest, careless) = (domain.node("honest"), domain.node("careless"));
    let honest = reliable(&honest, "honest");
    honest.wait_for_subscribers_timeout(1, SOON).unwrap();
    let mut number = 0;
    let mut publish = || {
        for _ in 0..MESSAGES {
            honest.publish(&number).unwrap();
            number += 1;
        }
    };
    publish();
    let mut flooded = flood(&careless, 150);
    recorder.await_stderr("32 topics are not recorded so far");
    publish();
    // Each file of the folder needs descriptors as well.
    flooded.truncate(50);
    publish();
    let summary = end(recorder);
    let topics = summary["topics"].as_array().unwrap();
    let found = topics.iter().find(|it| it["name"] == "honest").unwrap();
    assert_eq!(found["messages"], number);
    assert_eq!(found["lost"], 0);
    let missed = summary["not_recorded"].as_u64().unwrap();
    assert!((1..150).contains(&missed), "{missed}");
    let mut paths: Vec<_> = fs::read_dir(&folder)
        .unwrap()
        .map(|it| it.unwrap().path())
        .collect();
    paths.sort();
    assert!(paths.len() > 10, "{paths:?}");
    let last = paths.last().unwrap().to_str().unwrap();
    let (code, info, _) = bag(&["info", last, "--json"]);
    let info: Value = serde_json::from_str(&info).unwrap();
    assert_eq!((code, &info["not_recorded"]), (0, &missed.into()));
}

#[test]
fn a_recorder_raises_its_soft_limit_of_descriptors() {
    const PATH: &str = concat!(
        module_path!(),
        "::a_recorder_raises_its_soft_limit_of_descriptors"
    );
    if ran_alone(PATH) {
        return;
    }
    let domain = Domain::new();
    let path = domain.path("bag");
    let arguments = ["record", "--all", "--json", "-o", path.to_str().unwrap()];
    let recorder = Running::start(&mut limited(&domain, 64, 2_000, &arguments));
    let topics = flood(&domain.node("talker"), 60);
    for topic in &topics {
        topic.wait_for_subscribers_timeout(1, SOON).unwrap();
        topic.publish(&1).unwrap();
    }
    let summary = end(recorder);
    assert_eq!(summary["not_recorded"], 0);
    assert_eq!(summary["topics"].as_array().unwrap().len(), topics.len());
}
