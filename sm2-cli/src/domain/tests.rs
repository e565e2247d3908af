use sm2_proto::{Demand, InterfaceId, Offer};

use super::*;

fn name(text: &str) -> Name {
    Name::new(text).unwrap()
}

fn imu() -> TypeId {
    TypeId {
        name: name("sensor/Imu"),
        hash: 0xab,
    }
}

fn publisher(topic: &str) -> Contract {
    Contract::Publisher {
        topic: name(topic),
        data: imu(),
        offer: Offer {
            depth: 1,
            reliable: false,
            latched: 0,
            sealed: false,
        },
    }
}

fn subscriber(topic: &str, data: Option<TypeId>) -> Contract {
    Contract::Subscriber {
        topic: name(topic),
        data,
        demand: Demand {
            depth: 1,
            reliable: false,
            max_borrowed: 1,
            sealed: false,
        },
    }
}

fn node(number: u64, text: &str) -> Item {
    Item::Node {
        node: NodeId(number),
        name: name(text),
        uid: 1_000,
        pid: 7,
    }
}

fn interface(node: u64, number: u64, contract: Contract, links: u32) -> Item {
    Item::Interface {
        node: NodeId(node),
        interface: InterfaceId(number),
        contract,
        links,
    }
}

fn items() -> Vec<Item> {
    vec![
        node(1, "echo"),
        interface(1, 1, subscriber("imu", None), 2),
        interface(1, 2, subscriber("map", None), 0),
        node(2, "talker"),
        interface(2, 1, publisher("imu"), 1),
        interface(2, 2, publisher("imu"), 1),
        node(3, "list"),
    ]
}

#[test]
fn topics_are_counted_over_all_nodes() {
    let topics = topics(&items());
    let [imu, map] = topics.as_slice() else {
        panic!("{topics:?}");
    };
    assert_eq!((imu.publishers, imu.subscribers, imu.links), (2, 1, 2));
    assert_eq!(imu.data.as_ref().unwrap().schema, "00000000000000ab");
    assert_eq!((map.name.as_str(), map.data.as_ref()), ("map", None));
    assert_eq!((map.publishers, map.subscribers, map.links), (0, 1, 0));
}

#[test]
fn nodes_come_with_their_interfaces_and_without_who_asks() {
    let nodes = nodes(&items(), &name("list"));
    let [echo, talker] = nodes.as_slice() else {
        panic!("{nodes:?}");
    };
    assert_eq!((echo.name.as_str(), echo.subscribers), ("echo", 2));
    assert_eq!((talker.id, talker.uid, talker.pid), (2, 1_000, 7));
    assert_eq!((talker.publishers, talker.links), (2, 2));
    assert_eq!(super::nodes(&items(), &name("other")).len(), 3);
}
