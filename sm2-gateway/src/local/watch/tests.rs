use std::collections::BTreeSet;

use sm2_manager::{Background, Options};
use sm2_node::domain::Watch;
use sm2_test_support::until;

use super::*;
use crate::{
    domain::DomainLocation,
    names::{own_node, remote_node},
};

/// A Manager, and its folder.
struct Running {
    location: DomainLocation,
    _manager: Background,
    _folder: tempfile::TempDir,
}

impl Running {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("sock");
        Self {
            _manager: Background::start(&socket, Options::default()).unwrap(),
            location: DomainLocation::Socket(socket),
            _folder: folder,
        }
    }

    fn node(&self, name: &Name) -> Node {
        self.location.connect(name.as_str()).unwrap()
    }
}

fn name(text: &str) -> Name {
    Name::new(text).unwrap()
}

fn id(text: &str) -> TypeId {
    TypeId {
        name: name(text),
        hash: 0,
    }
}

fn topic(text: &str, reliable: bool, latched: u16) -> Subject {
    Subject::Topic {
        name: name(text),
        data: id("bytes"),
        reliable,
        latched,
    }
}

/// Returns once the gateway sees the domain so.
fn until_seen(
    watch: &mut Watch,
    remote: &RemoteTopics,
    present: &[Subject],
    taken: &[(Subject, GatewayId, u16, u64)],
) {
    let taken = taken.iter().cloned();
    let taken: BTreeMap<_, _> = taken
        .map(|(subject, origin, depth, generation)| ((subject, origin), (depth, generation)))
        .collect();
    let present: BTreeSet<_> = present.iter().collect();
    let mut seen = DomainState::default();
    until(&format!("{present:?}, {taken:?}"), || {
        watch.wait_timeout(Duration::from_millis(1)).unwrap();
        let now = DomainState::of(watch.domain(), &remote.lock().generations);
        if now != seen {
            println!("{now:?}");
            seen = now;
        }
        seen.present.keys().eq(present.iter().copied()) && seen.taken == taken
    });
}

/// The publishers of a topic together decide what the gateway offers. Interfaces of gateways are not a part of the
/// domain.
#[test]
fn a_topic_is_as_reliable_as_one_publisher_and_keeps_what_all_keep() {
    let running = Running::new();
    let gateway = running.node(&own_node(&name("robot")).unwrap());
    let mut watch = gateway.watch();
    let none = RemoteTopics::default();
    let nodes = ["one", "two", "three"].map(|it| running.node(&name(it)));
    let publish = |node: &Node, topic: &str, reliable, latched| {
        let builder = node.publisher_builder::<[u8]>(topic).type_id(id("bytes"));
        builder
            .reliable(reliable)
            .latched(latched)
            .declare()
            .unwrap()
    };
    let _first = publish(&nodes[0], "map", false, 2);
    until_seen(&mut watch, &none, &[topic("map", false, 2)], &[]);
    let second = publish(&nodes[1], "map", true, 3);
    until_seen(&mut watch, &none, &[topic("map", true, 5)], &[]);
    let _third = publish(&nodes[2], "map", false, 0);
    let peer = running.node(&remote_node(&name("far")).unwrap());
    let _others = [
        publish(&peer, "map", true, 7),
        publish(&gateway, "own", true, 0),
    ];
    let server = nodes[0].server_builder::<[u8], [u8]>("plan");
    let _server = server
        .type_ids(id("request"), id("reply"))
        .declare()
        .unwrap();
    let service = Subject::Service {
        name: name("plan"),
        request: id("request"),
        reply: id("reply"),
    };
    let present = [topic("map", true, 5), service.clone()];
    until_seen(&mut watch, &none, &present, &[]);
    drop(second);
    until_seen(&mut watch, &none, &[topic("map", false, 2), service], &[]);
}

#[test]
fn a_remote_topic_is_taken_with_the_greatest_depth_of_its_subscribers() {
    let running = Running::new();
    let gateway = running.node(&own_node(&name("robot")).unwrap());
    let mut watch = gateway.watch();
    let node = running.node(&name("listener"));
    let subscribe = |topic: &str, depth| {
        let builder = node.subscriber_builder::<[u8]>(topic);
        let builder = builder.type_id(id("bytes")).depth(depth);
        builder.declare().unwrap()
    };
    let (far, subject) = (GatewayId([7; 32]), topic("scan", false, 0));
    let remote = RemoteTopics::default();
    remote.insert(&subject, far);
    let _other = subscribe("map", 9);
    let _small = subscribe("scan", 3);
    let seen = |depth, generation| [(subject.clone(), far, depth, generation)];
    until_seen(&mut watch, &remote, &[], &seen(3, 1));
    let great = subscribe("scan", 5);
    until_seen(&mut watch, &remote, &[], &seen(5, 1));
    drop(great);
    until_seen(&mut watch, &remote, &[], &seen(3, 1));
    // The hub learns that a topic that comes again is another one.
    remote.remove(&(subject.clone(), far));
    until_seen(&mut watch, &remote, &[], &[]);
    remote.insert(&subject, far);
    until_seen(&mut watch, &remote, &[], &seen(3, 2));
}

/// The hub hears how many interfaces a session may have once, and again if that changes.
#[test]
fn a_limit_of_interfaces_is_said_when_it_changes() {
    let limited = |most| DomainState {
        interfaces: Some(most),
        ..DomainState::default()
    };
    let said = |before: &DomainState, now: &DomainState| {
        let events = before.difference(now).into_iter();
        let most = events.map(|it| match it {
            LocalEvent::Interfaces { most } => most,
            other => panic!("{other:?}"),
        });
        most.collect::<Vec<_>>()
    };
    let unknown = DomainState::default();
    for (before, now, expected) in [
        (&unknown, &limited(10), vec![9]),
        (&limited(10), &limited(10), vec![]),
        (&limited(10), &limited(7), vec![6]),
        (&limited(10), &unknown, vec![]),
    ] {
        assert_eq!(said(before, now), expected, "{before:?} {now:?}");
    }
}
