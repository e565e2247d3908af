//! A flood of topics: the recorder goes on with those that it has.

use std::{
    collections::BTreeSet,
    fs,
    process::{Command, Stdio},
};

use nix::sys::signal::Signal;
use serde_json::Value;
use sm2_node::{Node, Publisher};
use sm2_test_support::ran_alone;

use crate::{
    bag::bag,
    common::{Domain, Running, SOON, until},
};

/// How many messages there are before the flood, in it, and after it.
const MESSAGES: u64 = 100;

/// The topics of one node: a session has few interfaces.
const NODE_TOPICS: u32 = 200;

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

/// Ends a recording, whose status tells that topics are missing. Returns its summary.
fn end(recorder: Running, is_missing: bool) -> Value {
    recorder.signal(Signal::SIGINT);
    let finished = recorder.finish();
    assert_eq!(finished.code(), i32::from(is_missing), "{finished:?}");
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
    let summary = end(recorder, true);
    let topics = summary["topics"].as_array().unwrap();
    let found = topics.iter().find(|it| it["name"] == "honest").unwrap();
    assert_eq!(found["messages"], number);
    assert_eq!(found["lost"], 0);
    let missed = summary["not_recorded"].as_u64().unwrap();
    assert!((1..150).contains(&missed), "{missed}");
    // Each of them has its name. Recording one of them has begun late, or never.
    let missing = summary["missing"].as_array().unwrap();
    assert_eq!(missing.len() as u64, missed);
    for it in missing {
        let (topic, reason) = (
            it["topic"].as_str().unwrap(),
            it["reason"].as_str().unwrap(),
        );
        assert!(topic.starts_with("flood/"), "{it}");
        assert!(
            reason.contains("too few descriptors") || reason.contains("linked"),
            "{it}"
        );
    }
    let mut paths: Vec<_> = fs::read_dir(&folder)
        .unwrap()
        .map(|it| it.unwrap().path())
        .collect();
    paths.sort();
    assert!(paths.len() > 10, "{paths:?}");
    // Each file names those that it lacks.
    let mut names = BTreeSet::new();
    for path in paths {
        let (code, info, _) = bag(&["info", path.to_str().unwrap(), "--json"]);
        assert_eq!(code, 0, "{info}");
        let info: Value = serde_json::from_str(&info).unwrap();
        let missing = info["missing"].as_array().unwrap().iter();
        names.extend(missing.map(|it| it["topic"].to_string()));
    }
    assert_eq!(names.len() as u64, missed);
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
    let summary = record_all(64, 2_000, 60);
    assert_eq!(summary["not_recorded"], 0);
}

/// Records so many topics with these limits of descriptors. Each of them is recorded or named as missing.
fn record_all(soft: u64, hard: u64, count: u32) -> Value {
    // Each topic is a link of this process, too.
    sm2_io::raise_descriptor_limit();
    let domain = Domain::new();
    let path = domain.path("bag");
    let arguments = ["record", "--all", "--json", "-o", path.to_str().unwrap()];
    let recorder = Running::start(&mut limited(&domain, soft, hard, &arguments));
    let nodes = (0..count.div_ceil(NODE_TOPICS)).map(|it| domain.node(&format!("talker/{it}")));
    let nodes: Vec<_> = nodes.collect();
    let topic = |it: u32| reliable(&nodes[(it / NODE_TOPICS) as usize], &format!("topic/{it}"));
    let topics: Vec<_> = (0..count).map(topic).collect();
    let is_linked = |it: &&Publisher<u64>| it.links().iter().any(|it| it.open);
    let missing_so_far = || {
        let (_, info, _) = bag(&["info", path.to_str().unwrap(), "--json"]);
        let info: Value = serde_json::from_str(&info).unwrap_or_default();
        let missing = info["missing"].as_array().cloned().unwrap_or_default();
        missing.iter().filter(|it| it["to_ns"].is_null()).count()
    };
    let subscribed = || {
        let list = domain.list("topic");
        let list = list["topics"].as_array().unwrap().iter();
        list.filter(|it| it["subscribers"] == 1).count()
    };
    until("each topic is subscribed to or missing", || {
        topics.iter().all(|it| is_linked(&it)) || subscribed() + missing_so_far() >= topics.len()
    });
    let linked: Vec<_> = topics.iter().filter(is_linked).collect();
    for topic in &linked {
        topic.publish(&1).unwrap();
    }
    let summary = end(recorder, linked.len() < topics.len());
    let names = |list: &str, key: &str| -> BTreeSet<String> {
        let all = summary[list].as_array().unwrap().iter();
        all.map(|it| it[key].as_str().unwrap().to_owned()).collect()
    };
    let (recorded, missing) = (names("topics", "name"), names("missing", "topic"));
    assert_eq!(summary["not_recorded"], missing.len());
    assert!(
        linked
            .iter()
            .all(|it| recorded.contains(it.topic().as_str()))
    );
    let named: BTreeSet<_> = recorded.union(&missing).cloned().collect();
    assert_eq!(named, (0..count).map(|it| format!("topic/{it}")).collect());
    summary
}

/// The usual soft limit is raised to the hard one, and topics beyond that are named.
#[test]
fn each_of_many_topics_is_recorded_or_named() {
    const PATH: &str = concat!(module_path!(), "::each_of_many_topics_is_recorded_or_named");
    if ran_alone(PATH) {
        return;
    }
    let (limit, count) = match cfg!(feature = "slow") {
        true => (1_024, 2_000),
        false => (256, 200),
    };
    let summary = record_all(limit, 20_000, count);
    assert_eq!(summary["not_recorded"], 0);
    let summary = record_all(limit, limit, count);
    assert!(summary["not_recorded"].as_u64() > Some(u64::from(count) / 4));
}

#[test]
fn topics_beyond_a_session_are_recorded_in_further_ones() {
    let domain = Domain::with(&["--interfaces-per-session", "10"]);
    let path = domain.path("bag");
    let arguments = ["record", "--all", "--json", "-o", path.to_str().unwrap()];
    let recorder = domain.start(&arguments);
    let nodes: Vec<_> = (0..3)
        .map(|it| domain.node(&format!("talker/{it}")))
        .collect();
    let topic = |it: usize| reliable(&nodes[it % 3], &format!("topic/{it}"));
    let topics: Vec<_> = (0..24).map(topic).collect();
    for topic in &topics {
        topic.wait_for_subscribers_timeout(1, SOON).unwrap();
        topic.publish(&1).unwrap();
    }
    let summary = end(recorder, false);
    let recorded = summary["topics"].as_array().unwrap();
    assert_eq!(recorded.len(), topics.len());
    assert!(
        recorded.iter().all(|it| it["messages"] == 1),
        "{recorded:?}"
    );
}

#[test]
fn a_topic_that_was_never_linked_is_missing() {
    let domain = Domain::new();
    let chatter = reliable(&domain.node("talker"), "chatter");
    for is_allowed in [false, true] {
        let path = domain.path(&format!("bag-{is_allowed}.mcap"));
        let file = path.to_str().unwrap();
        let arguments = ["record", "chatter", "silence", "--json", "-o", file];
        let allow = ["--allow-missing"];
        let allow = if is_allowed { &allow[..] } else { &[] };
        let recorder = domain.start(&[&arguments[..], allow].concat());
        chatter.wait_for_subscribers_timeout(1, SOON).unwrap();
        let summary = end(recorder, !is_allowed);
        let missing = summary["missing"].as_array().unwrap();
        assert_eq!(missing.len(), 1, "{missing:?}");
        assert_eq!(
            (&missing[0]["topic"], &missing[0]["to_ns"]),
            (&"silence".into(), &Value::Null)
        );
        let (code, text, _) = bag(&["info", file]);
        let line = "to the end: no publisher was linked";
        assert!(
            code == 0 && text.contains("MISSING silence") && text.contains(line),
            "{text}"
        );
    }
}
