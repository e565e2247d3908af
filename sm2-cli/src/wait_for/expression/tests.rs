use sm2_proto::{
    Contract, DemandedQos, EntityId, InterfaceId, NodeId, OfferedQos, TypeId, control::Item,
};

use super::*;

fn name(text: &str) -> Name {
    Name::new(text).unwrap()
}

fn entity(node: u64, interface: u64) -> EntityId {
    EntityId {
        node: NodeId(node),
        interface: InterfaceId(interface),
    }
}

/// `talker` publishes `scan`, `listener` subscribes to it.
fn domain() -> Domain {
    let node = |node, text| Item::Node {
        node: NodeId(node),
        name: name(text),
        uid: 0,
        pid: 1,
        resuming: false,
        max_links: None,
    };
    let publisher = Contract::Publisher {
        topic: name("scan"),
        data: TypeId {
            name: name("bytes"),
            hash: 0,
        },
        offer: OfferedQos::new(1),
    };
    let subscriber = Contract::Subscriber {
        topic: name("scan"),
        data: None,
        demand: DemandedQos::new(1, 1),
    };
    let mut domain = Domain::new();
    domain.page([
        node(1, "talker"),
        node(2, "listener"),
        Item::Interface {
            entity: entity(1, 1),
            contract: publisher,
        },
        Item::Interface {
            entity: entity(2, 1),
            contract: subscriber,
        },
        Item::Link {
            link: sm2_proto::LinkId {
                epoch: 1,
                serial: 1,
            },
            offering: entity(1, 1),
            demanding: entity(2, 1),
            version: 1,
            reliable: false,
            sealed: false,
        },
    ]);
    domain
}

#[test]
fn expressions_are_true_or_not() {
    for (text, met) in [
        ("topic:/scan publishers>=1 subscribers>=1 links==1", true),
        ("topic:scan publishers > 1", false),
        ("topic:scan publishers=1", true),
        ("topic:scan publishers!=1", false),
        ("topic:scan links<2 links<=1 links>0", true),
        ("topic:other publishers==0", true),
        ("service:scan servers>=1", false),
        ("service:scan servers==0 clients==0 links==0", true),
        ("node:talker", true),
        ("node:talker up publishers==1 subscribers==0 links==1", true),
        ("node:talker gone", false),
        ("node:nobody gone", true),
        ("  node:nobody   up ", false),
    ] {
        let expression = Expression::parse(text).unwrap();
        assert_eq!(expression.is_met(&domain()), met, "{text}");
    }
}

#[test]
fn errors_point_at_their_place() {
    for (text, position, what) in [
        ("", 1, "topic:NAME"),
        ("scan", 1, "topic:NAME"),
        ("tropic:scan x", 1, "topic:, service: or node:"),
        ("topic:a b", 9, "publishers>=1"),
        ("topic:a//b links>0", 7, "a name is"),
        ("topic:a", 8, "a condition"),
        ("topic:a servers>=1", 9, "publishers>=1"),
        ("service:a publishers>=1", 11, "servers>=1"),
        ("topic:a up", 9, "publishers>=1"),
        ("topic:a publishers", 19, "== != >="),
        ("topic:a publishers 1", 20, "== != >="),
        ("topic:a publishers>=", 21, "whole number"),
        ("topic:a publishers>=-1", 21, "whole number"),
        ("topic:a publishers>=1x", 21, "whole number"),
        ("node:a up5", 10, "a blank"),
        ("topic:ä links>0", 7, "a name is"),
    ] {
        let error = Expression::parse(text).unwrap_err();
        let start = format!("at character {position} ");
        assert!(
            error.starts_with(&start) && error.contains(what),
            "{text}: {error}"
        );
    }
}

#[test]
fn what_was_seen_is_told() {
    let seen = |text| Expression::parse(text).unwrap().seen(&domain()).to_string();
    assert_eq!(
        seen("topic:scan publishers>=2"),
        "'topic:scan publishers>=2' is not true: 1 publisher, 1 subscriber, 1 link"
    );
    assert_eq!(
        seen("node:x"),
        "'node:x' is not true: the node is not there"
    );
}
