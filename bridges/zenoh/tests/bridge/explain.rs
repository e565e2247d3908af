//! The decisions that `explain` prints are those of a running bridge, for random rules and names.

use std::collections::BTreeSet;
use std::sync::mpsc::channel;

use crate::common::World;
use sm2_bridge_zenoh::Config;
use sm2_node::{Publisher, Subscriber};
use sm2_proto::Name;
use sm2_proto::gateway::{Direction, SubjectKind};
use sm2_test_support::{SOON, seed, until};
use zenoh::Wait;

/// How many sets of rules are tried.
const CASES: usize = 4;
const RULES: usize = 6;
/// The segments of names and patterns: so few that many rules match.
const SEGMENTS: [&str; 3] = ["arm", "camera", "pose"];
const PATTERNS: [&str; 5] = ["arm", "camera", "pose", "*", "**"];
/// All rules let it pass in both directions, after all other messages.
const MARKER: &str = "marker";

/// Random choices that follow from the seed of the test.
struct Draw(fastrand::Rng);

impl Draw {
    fn one<'a>(&mut self, all: &[&'a str]) -> &'a str {
        all[self.0.usize(..all.len())]
    }

    fn segments(&mut self, all: &[&'static str]) -> String {
        let count = self.0.usize(1..=3);
        let segments: Vec<_> = (0..count).map(|_| self.one(all)).collect();
        segments.join("/")
    }

    fn rule(&mut self) -> String {
        let action = self.one(&["allow", "deny"]);
        let direction = self.one(&["in", "out", "both"]);
        let kind = self.one(&["", "", "kind = \"topic\"\n", "kind = \"service\"\n"]);
        let names = self.segments(&PATTERNS);
        format!(
            "[[rule]]\naction = \"{action}\"\n{kind}names = \"{names}\"\ndirection = \"{direction}\"\n"
        )
    }

    fn rules(&mut self) -> String {
        let rules: String = (0..RULES).map(|_| self.rule()).collect();
        format!("[[rule]]\naction = \"allow\"\nnames = \"{MARKER}\"\n{rules}")
    }
}

/// All names of one and two segments, and those of three that begin twice alike.
fn names() -> Vec<String> {
    let mut names: Vec<String> = SEGMENTS.map(str::to_owned).to_vec();
    for first in SEGMENTS {
        names.extend(SEGMENTS.map(|second| format!("{first}/{second}")));
        names.extend(SEGMENTS.map(|last| format!("{first}/{first}/{last}")));
    }
    names.push(MARKER.to_owned());
    names
}

fn allowed(config: &Config, direction: Direction) -> BTreeSet<String> {
    let mut names = names();
    names.retain(|it| {
        let name = Name::new(it).unwrap();
        let decision = config.explain(SubjectKind::Topic, &name, direction);
        decision.is_allowed
    });
    names.into_iter().collect()
}

#[test]
fn explain_agrees_with_the_messages_that_pass() {
    let mut draw = Draw(fastrand::Rng::with_seed(seed()));
    for _ in 0..CASES {
        let rules = draw.rules();
        println!("{rules}");
        go_out(&rules);
        come_in(&rules);
    }
}

/// Each topic of a domain has a message; the one of the marker is the last.
fn go_out(rules: &str) {
    let world = World::new();
    let config = world.config("name = \"seven\"", &world.endpoint, rules);
    let (sender, arrived) = channel();
    let subscriber = world.network.declare_subscriber("sm2/**");
    let subscriber = subscriber.callback(move |sample| {
        let _ = sender.send(sample.key_expr().as_str()["sm2/".len()..].to_owned());
    });
    subscriber.background().wait().unwrap();
    let bridge = world.bridge("name = \"seven\"", rules);
    let node = world.node("robot");
    let declare = |name: &String| (name.clone(), node.publisher::<[u8]>(name).unwrap());
    let publishers: Vec<(String, Publisher<[u8]>)> = names().iter().map(declare).collect();
    let expected = allowed(&config, Direction::Out);
    // A topic that may not pass never gets a subscriber, and those after it in the order of declaration do.
    for (name, publisher) in &publishers {
        if expected.contains(name) {
            until("the bridge subscribes", || !publisher.links().is_empty());
            publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
        }
    }
    for (_, publisher) in &publishers {
        publisher.publish(b"message").unwrap();
    }
    let mut found = BTreeSet::new();
    while found.len() < expected.len() {
        found.insert(arrived.recv_timeout(SOON).unwrap());
    }
    assert_eq!(found, expected);
    let counts = bridge.end();
    assert_eq!(counts.sent, expected.len() as u64, "{counts:?}");
}

/// Each topic of the network has a message; the one of the marker is the last.
fn come_in(rules: &str) {
    let world = World::new();
    let config = world.config("name = \"seven\"", &world.endpoint, rules);
    let node = world.node("robot");
    let declare = |name: &String| (name.clone(), node.subscriber::<[u8]>(name).unwrap());
    let subscribers: Vec<(String, Subscriber<[u8]>)> = names().iter().map(declare).collect();
    let bridge = world.bridge("name = \"seven\"", rules);
    // The marker comes when the network knows the subscription of the bridge.
    let marker = &subscribers.last().unwrap().1;
    until("the network knows the bridge", || {
        let put = world.network.put(format!("sm2/{MARKER}"), "message");
        put.wait().unwrap();
        marker.try_recv().unwrap().is_some()
    });
    for name in names() {
        world
            .network
            .put(format!("sm2/{name}"), "message")
            .wait()
            .unwrap();
    }
    world
        .network
        .put(format!("sm2/{MARKER}"), "the last")
        .wait()
        .unwrap();
    loop {
        let message = marker.recv_timeout(SOON).unwrap().expect("the marker");
        if *message == *b"the last" {
            break;
        }
    }
    let expected = allowed(&config, Direction::In);
    for (name, subscriber) in &subscribers[..subscribers.len() - 1] {
        if expected.contains(name) {
            // The first message may have come before the link to the subscriber was open.
            until("it comes", || {
                let key = format!("sm2/{name}");
                world.network.put(key, "message").wait().unwrap();
                subscriber.try_recv().unwrap().is_some()
            });
        } else {
            assert!(subscriber.try_recv().unwrap().is_none(), "{name}");
        }
    }
    let counts = bridge.end();
    let denied = (names().len() - expected.len()) as u64;
    assert_eq!(counts.denied, denied, "{counts:?}");
}
