//! Two domains with a gateway and a bridge between them: a ring.

use crate::common::{ALL, Running, World, receive};
use sm2_gateway::{Config, Gateway, keys};
use sm2_node::{Node, Publisher, Subscriber};
use sm2_test_support::until;
use tokio::runtime::Runtime;

/// How many messages are sent each way while the ring is complete.
const MESSAGES: u8 = 50;

/// Starts the gateway of a domain, which trusts one peer.
fn gateway(world: &World, runtime: &Runtime, name: &str, peer: &str) -> Gateway {
    let text = format!(
        "name = \"{name}\"\nlisten = \"127.0.0.1:0\"\nkey = \"key\"\nsocket = \"sock\"\n{peer}{ALL}"
    );
    let config = Config::parse(&world.path("gateway.toml"), &text).unwrap();
    runtime.block_on(Gateway::start(&config)).unwrap()
}

fn publisher(node: &Node, topic: &str) -> Publisher<[u8]> {
    let builder = node.publisher_builder::<[u8]>(topic);
    // Gateways may lose messages of topics that are not reliable.
    builder.reliable(true).depth(256).declare().unwrap()
}

fn subscriber(node: &Node, topic: &str) -> Subscriber<[u8]> {
    let builder = node.subscriber_builder::<[u8]>(topic);
    builder.depth(256).declare().unwrap()
}

/// A topic that both the gateways and the bridges carry from one domain to the other one.
struct Way<'a> {
    publisher: Publisher<[u8]>,
    /// In the domain of the publisher.
    own: Subscriber<[u8]>,
    /// In the other domain.
    other: Subscriber<[u8]>,
    /// The bridge of the other domain.
    bridge: &'a Running,
}

impl Way<'_> {
    fn left_to_gateway(&self) -> u64 {
        self.bridge.account().counts.left_to_gateway
    }

    fn carries_each_message_once(&self) {
        // Until the ring is complete, and both bridges know that, messages may come by both ways, or by none: a bridge
        // leaves a topic to the gateway as soon as the gateway offers it.
        let mut by_gateway = false;
        until("the gateways bring the topic", || {
            self.publisher.publish(&[0]).unwrap();
            while self.own.try_recv().unwrap().is_some() {}
            while let Some(sample) = self.other.try_recv().unwrap() {
                by_gateway |= !sample.publisher().as_str().ends_with("_bridge");
            }
            by_gateway && self.left_to_gateway() > 0
        });
        self.publisher.publish(&[1]).unwrap();
        while receive(&self.other) != [1] {}
        while receive(&self.own) != [1] {}
        let before = self.left_to_gateway();
        for number in 2..2 + MESSAGES {
            self.publisher.publish(&[number]).unwrap();
            assert_eq!(receive_later(&self.other), [number]);
            assert_eq!(receive_later(&self.own), [number]);
        }
        // The bridge has taken all of them from its network, and left them to the gateway.
        until("all have come by both ways", || {
            self.left_to_gateway() >= before + u64::from(MESSAGES)
        });
        self.publisher.publish(b"marker").unwrap();
        // A copy of the messages before would come first.
        assert_eq!(receive_later(&self.other), b"marker");
        assert_eq!(receive_later(&self.own), b"marker");
    }
}

/// The next message that is not of the time before the ring was complete: one of those may still come by the other way.
fn receive_later(subscriber: &Subscriber<[u8]>) -> Vec<u8> {
    loop {
        match receive(subscriber) {
            message if message == [0] => {}
            message => return message,
        }
    }
}

#[test]
fn nothing_arrives_twice_and_nothing_returns_in_a_ring() {
    let (near, far) = (World::new(), World::new());
    let builder = &mut tokio::runtime::Builder::new_multi_thread();
    let runtime = builder.worker_threads(2).enable_all().build().unwrap();
    let ids = [&near, &far].map(|it| keys::generate(&it.path("key")).unwrap().id());
    let head = |name| format!("name = \"{name}\"\nprefix = \"ring\"");
    let near_bridge = near.bridge(&head("near_bridge"), ALL);
    let far_bridge = far.bridge_to(&near.endpoint, &head("far_bridge"), ALL);
    let peer =
        |name: &str, id, rest: &str| format!("[[peer]]\nname = \"{name}\"\nid = \"{id}\"\n{rest}");
    let far_gateway = gateway(&far, &runtime, "far", &peer("near", ids[0], ""));
    let address = format!("addresses = [\"{}\"]\n", far_gateway.address());
    let near_gateway = gateway(&near, &runtime, "near", &peer("far", ids[1], &address));

    let (here, there) = (near.node("robot"), far.node("station"));
    let pose = Way {
        publisher: publisher(&here, "pose"),
        own: subscriber(&here, "pose"),
        other: subscriber(&there, "pose"),
        bridge: &far_bridge,
    };
    pose.carries_each_message_once();
    let command = Way {
        publisher: publisher(&there, "command"),
        own: subscriber(&there, "command"),
        other: subscriber(&here, "command"),
        bridge: &near_bridge,
    };
    command.carries_each_message_once();
    for bridge in [&near_bridge, &far_bridge] {
        let counts = bridge.account().counts;
        assert_eq!(counts.returned, 0, "{counts}");
    }

    // Without its gateway, a domain gets the messages from its bridge.
    runtime.block_on(near_gateway.stop());
    let received = far_bridge.account().counts.received;
    until("the bridge brings the topic", || {
        pose.publisher.publish(b"alone").unwrap();
        assert_eq!(receive(&pose.own), b"alone");
        far_bridge.account().counts.received > received
    });
    while receive(&pose.other) != b"alone" {}
    runtime.block_on(far_gateway.stop());
    near_bridge.end();
    far_bridge.end();
}
