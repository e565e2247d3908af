//! The messages of the network that wait for the links of new topics.

use std::borrow::Cow;
use std::time::Duration;

use sm2_bridge_core::config::RuleTables;
use sm2_bridge_core::{Arrival, Delivery, Ended, Inbound, Member, Origin, Payload, Verdict};
use sm2_gateway::DomainLocation;
use sm2_manager::{Background, Options};
use sm2_node::{Node, Subscriber};
use sm2_proto::gateway::{Action, Pattern, Rule, Rules};
use sm2_proto::{Name, TypeId};
use sm2_test_support::{SOON, until};

/// The number of messages that may wait.
const WAITING_MAX: usize = 1_024;

struct Message(u8);

impl Payload for Message {
    fn payload(&self) -> Cow<'_, [u8]> {
        Cow::Owned(vec![self.0])
    }
}

fn name(text: &str) -> Name {
    Name::new(text).unwrap()
}

fn data() -> TypeId {
    TypeId {
        name: name("pose"),
        hash: 7,
    }
}

/// Message `number` of a bridge of another domain, which must not be lost.
fn arrival(topic: &str, number: u64) -> Arrival {
    Arrival {
        topic: (name(topic), data()),
        origin: Some(Origin {
            bridge: name("robot"),
            epoch: 5,
            number,
        }),
        delivery: Delivery::AtLeastOnce,
    }
}

/// The part of a bridge that is in a domain, whose rules let all in.
struct Site {
    _manager: Background,
    folder: tempfile::TempDir,
    member: Member,
    inbound: Inbound<Message>,
    rules: RuleTables,
}

impl Site {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("sock");
        let manager = Background::start(&socket, Options::default()).unwrap();
        let member = Member::join(&DomainLocation::Socket(socket), &name("site")).unwrap();
        let rule = Rule {
            action: Action::Allow,
            kind: None,
            names: Pattern::new("**").unwrap(),
            direction: None,
            peers: None,
        };
        Self {
            inbound: Inbound::new(member.remote.clone()),
            rules: RuleTables {
                rules: Rules(vec![rule]),
                notes: Vec::new(),
            },
            _manager: manager,
            folder,
            member,
        }
    }

    fn node(&self, name: &str) -> Node {
        let socket = self.folder.path().join("sock");
        Node::builder(name).socket(socket).connect().unwrap()
    }

    fn receive(&mut self, arrival: Arrival) {
        let domain = self.member.watch.domain();
        let message = Message(arrival.origin.as_ref().unwrap().number as u8);
        (self.inbound).receive(&self.rules, domain, arrival, message);
    }
}

/// The topic, the number and the end of each message.
fn ends(ended: Vec<Ended<Message>>) -> Vec<(String, u64, Verdict)> {
    let end = |it: Ended<Message>| {
        let Arrival { topic, origin, .. } = it.arrival;
        (topic.0.to_string(), origin.unwrap().number, it.verdict)
    };
    ended.into_iter().map(end).collect()
}

/// A subscriber that is never linked, since no bridge promises a deadline.
fn never_linked(node: &Node, topic: &str) -> Subscriber<[u8]> {
    let builder = node.subscriber_builder::<[u8]>(topic).type_id(data());
    builder.deadline(Duration::from_secs(1)).declare().unwrap()
}

/// Waits until the bridge knows the subscribers of the node `viewer`.
fn follow(site: &mut Site, subscribers: usize) {
    until("the bridge knows the subscribers", || {
        site.member.watch.try_wait().unwrap();
        let domain = site.member.watch.domain();
        let viewer = domain.node_named("viewer").map(|it| it.node);
        viewer.is_some_and(|it| domain.interfaces_of(it).count() == subscribers)
    });
}

#[test]
fn no_message_waits_for_the_links_of_another_topic() {
    let mut site = Site::new();
    let viewer = site.node("viewer");
    let _pose = never_linked(&viewer, "pose");
    let speed = viewer.subscriber_builder::<[u8]>("speed").type_id(data());
    let speed = speed.declare().unwrap();
    follow(&mut site, 2);
    site.receive(arrival("pose", 1));
    site.receive(arrival("pose", 2));
    // The network brings a message again that is not acknowledged.
    site.receive(arrival("pose", 1));
    site.receive(arrival("speed", 3));

    let mut ended = Vec::new();
    until("all messages are published", || {
        ended.extend(ends(site.inbound.take_ended()));
        ended.len() == 4
    });
    assert_eq!(site.inbound.timeout(), None);
    assert_eq!(ended[0], ("speed".into(), 3, Verdict::Published));
    let rest = [
        ("pose".into(), 1, Verdict::Published),
        ("pose".into(), 2, Verdict::Published),
        ("pose".into(), 1, Verdict::Duplicate),
    ];
    assert_eq!(ended[1..], rest);
    let sample = speed.recv_timeout(SOON).unwrap().unwrap();
    assert_eq!(*sample, [3]);
}

#[test]
fn the_messages_that_wait_are_bounded() {
    let mut site = Site::new();
    let viewer = site.node("viewer");
    let _pose = never_linked(&viewer, "pose");
    follow(&mut site, 1);
    for number in 1..=WAITING_MAX as u64 + 1 {
        site.receive(arrival("pose", number));
    }
    let ended = ends(site.inbound.take_all());
    assert_eq!(ended.len(), WAITING_MAX + 1);
    assert_eq!(
        ended[0],
        ("pose".into(), WAITING_MAX as u64 + 1, Verdict::Dropped)
    );
    assert!(ended[1..].iter().all(|it| it.2 == Verdict::Published));
}
