//! Durable topics: outages of the network, of the other bridge, and of the bridge itself.

use std::path::Path;
use std::sync::mpsc::channel;

use sm2_bridge_core::{Delivery, Origin};
use sm2_bridge_zenoh::{Config, SpoolCounts};
use sm2_node::{Publisher, Subscriber};
use sm2_proto::Name;
use sm2_test_support::{SOON, until};
use zenoh::Wait;

use crate::common::{Running, World, is_linked, receive};

const OUT: &str = "[spool]\nfolder = \"spool\"\n[[rule]]\naction = \"allow\"\nnames = \"pose\"\ndurable = true\n\
     direction = \"out\"\n";
const IN: &str = "[[rule]]\naction = \"allow\"\nnames = \"pose\"\ndirection = \"in\"\n";

fn head(name: &str) -> String {
    format!("name = \"{name}\"\nprefix = \"robot/7\"")
}

/// A robot that publishes numbers, and a site whose subscriber takes them.
struct Fleet {
    robot: World,
    site: World,
    publisher: Publisher<[u8]>,
    subscriber: Subscriber<[u8]>,
    next: u8,
    /// The numbers that the site has not taken yet.
    expected: Vec<u8>,
}

impl Fleet {
    fn new() -> Self {
        let (robot, site) = (World::new(), World::new());
        let publisher = robot.node("driver").publisher::<[u8]>("pose").unwrap();
        let subscriber = site.node("map").subscriber_builder::<[u8]>("pose");
        Self {
            publisher,
            subscriber: subscriber.depth(64).declare().unwrap(),
            robot,
            site,
            next: 0,
            expected: Vec::new(),
        }
    }

    /// Publishes messages, which the bridge has when it returns.
    fn publish(&mut self, count: u8) {
        until("the bridge takes the topic", || is_linked(&self.publisher));
        for _ in 0..count {
            self.next += 1;
            self.publisher.publish(&[self.next]).unwrap();
            self.expected.push(self.next);
        }
        until("the bridge has the messages", || {
            let links = self.publisher.links();
            let counters = links.iter().filter(|it| it.open).map(|it| it.counters);
            counters.into_iter().all(|it| it.delivered == it.offered)
        });
    }

    /// Takes messages until all that were published have come, in their order. A bridge that starts anew may deliver
    /// some once more.
    fn take_all(&mut self) {
        for expected in std::mem::take(&mut self.expected) {
            let number = loop {
                let number = receive(&self.subscriber)[0];
                if number >= expected {
                    break number;
                }
            };
            assert_eq!(number, expected, "a message is missing");
        }
    }
}

/// Ends the bridge of the robot.
fn end(bridge: Running) -> SpoolCounts {
    let counts = bridge.end_with_spool().spool.unwrap();
    assert!(counts.is_balanced(), "{counts:?}");
    counts
}

#[test]
fn messages_wait_for_the_other_bridge_and_for_their_own() {
    let mut fleet = Fleet::new();
    let robot = fleet.robot.bridge(&head("robot"), OUT);
    fleet.publish(5);
    // The bridge of the robot starts anew while nobody takes its messages.
    let counts = end(robot);
    assert_eq!((counts.spooled, counts.handed_over), (5, 0), "{counts:?}");
    let robot = fleet.robot.bridge(&head("robot"), OUT);
    fleet.publish(5);
    for _ in 0..2 {
        let site = fleet
            .site
            .bridge_to(&fleet.robot.endpoint, &head("site"), IN);
        fleet.take_all();
        fleet.publish(5);
        fleet.take_all();
        site.end();
        fleet.publish(5);
    }
    let site = fleet
        .site
        .bridge_to(&fleet.robot.endpoint, &head("site"), IN);
    fleet.take_all();
    let counts = end(robot);
    site.end();
    assert_eq!((counts.offered, counts.expired, counts.refused), (30, 0, 0));
}

/// The numbers of origins begin anew with each publisher of a topic that has none.
#[test]
fn messages_of_the_next_publisher_are_no_duplicates() {
    let mut fleet = Fleet::new();
    let robot = fleet.robot.bridge(&head("robot"), OUT);
    let site = fleet
        .site
        .bridge_to(&fleet.robot.endpoint, &head("site"), IN);
    fleet.publish(5);
    fleet.take_all();
    let node = fleet.robot.node("next");
    fleet.publisher = node.publisher("other").unwrap();
    until("the bridge takes the topic no more", || {
        let domain = node.snapshot().unwrap();
        let bridge = domain.node_named("bridge/robot").unwrap().node;
        !domain.interfaces().any(|it| it.entity.node == bridge)
    });
    fleet.publisher = node.publisher("pose").unwrap();
    fleet.publish(5);
    fleet.take_all();
    end(robot);
    site.end();
}

#[test]
fn messages_wait_for_a_router_that_is_away() {
    let mut fleet = Fleet::new();
    fleet.robot.network.close().wait().unwrap();
    // A peer starts without the router; a client would not.
    let config = fleet
        .robot
        .config_of("peer", &head("robot"), &fleet.robot.endpoint, OUT);
    let robot = Running::start(&config);
    fleet.publish(5);
    fleet.robot.open_network();
    let site = fleet
        .site
        .bridge_to(&fleet.robot.endpoint, &head("site"), IN);
    fleet.take_all();
    fleet.robot.network.close().wait().unwrap();
    fleet.publish(5);
    fleet.robot.open_network();
    fleet.take_all();
    let counts = end(robot);
    site.end();
    assert_eq!((counts.offered, counts.expired, counts.refused), (10, 0, 0));
}

#[test]
fn a_message_that_comes_again_is_acknowledged_and_not_published_again() {
    let world = World::new();
    let subscriber = world.node("map").subscriber::<[u8]>("pose").unwrap();
    let bridge = world.bridge(&head("site"), IN);
    let (sender, acks) = channel();
    let listener = world.network.declare_subscriber("robot/7/@ack/robot");
    let listener = listener.callback(move |sample| {
        let attachment = sample.attachment().unwrap().to_bytes().into_owned();
        let _ = sender.send((sample.payload().to_bytes().into_owned(), attachment));
    });
    listener.background().wait().unwrap();
    let token = world.network.liveliness();
    until("the bridge takes topics", || {
        let tokens = token.get("robot/7/@bridge/**").wait().unwrap();
        tokens.into_iter().any(|it| it.result().is_ok())
    });
    let origin = |number| Origin {
        bridge: Name::new("robot").unwrap(),
        epoch: 3,
        number,
    };
    // The last one is a marker: nothing else comes before it.
    for number in [1, 1, 2, 1, 3] {
        let put = world.network.put("robot/7/pose", vec![number]);
        let attachment = origin(number.into()).encode(Delivery::AtLeastOnce);
        put.attachment(attachment).wait().unwrap();
        let (topic, acknowledged) = acks.recv_timeout(SOON).unwrap();
        assert_eq!(topic, b"pose");
        let acknowledged = Origin::decode(&acknowledged).unwrap().0;
        assert_eq!(acknowledged, origin(number.into()));
    }
    for number in 1..=3 {
        assert_eq!(receive(&subscriber), [number]);
    }
    let counts = bridge.end();
    assert_eq!((counts.received, counts.duplicates), (3, 2), "{counts:?}");
}

#[test]
fn only_rules_that_let_topics_out_make_them_durable() {
    let refused = |text: &str| {
        let error = Config::parse(Path::new("bridge.toml"), text).unwrap_err();
        error.to_string()
    };
    let spool = "[zenoh]\n[spool]\nfolder = \"s\"\n";
    let rule = "[[rule]]\naction = \"allow\"\nnames = \"a\"\n";
    for (text, expected) in [
        (
            format!("name = \"a\"\n[zenoh]\n{rule}durable = true\n"),
            "bridge.toml:6: a durable topic needs a table `[spool]`",
        ),
        (
            format!("name = \"a\"\n{spool}{rule}direction = \"in\"\ndurable = true\n"),
            "bridge.toml:9: `durable` needs mode `plain`",
        ),
        (
            format!("name = \"a\"\n{spool}{rule}kind = \"service\"\ndurable = true\n"),
            "bridge.toml:9: `durable` needs",
        ),
        (
            format!("name = \"a\"\nmode = \"ros2\"\n{spool}{rule}durable = true\n"),
            "bridge.toml:9: `durable` needs",
        ),
        (
            format!("name = \"a\"\n{spool}{rule}durable = true\nmessages_per_s = 1\n"),
            "bridge.toml:5: `priority`, `messages_per_s`, `bytes_per_s` and `max_age_ms` have no effect on durable",
        ),
        (
            format!("name = \"a\"\n{spool}max_bytes = 1\nwindow_bytes = 2\n"),
            "bridge.toml:3: `window_bytes` (2) is at most `max_bytes` (1)",
        ),
    ] {
        let error = refused(&text);
        assert!(error.starts_with(expected), "{error}");
    }
}
