//! QUERY: a domain that is larger than a datagram, read a page at a time.

use crate::support::{
    bench::{Bench, EPOCH, Event, claim, resuming},
    contracts::{data, name, publisher, server, subscriber},
};
use sm2_proto::{
    Code, Contract, EntityId, InterfaceId, LinkId, NodeId, Refusal,
    control::{Item, Key, Limits, Page, ToManager, ToNode, UnlinkedReason, encode_to_node},
    limits::{DATAGRAM_MAX, PAGE_BYTES},
};

fn query(bench: &mut Bench, node: NodeId, after: Option<Key>) -> Page {
    let events = bench.send(node, &ToManager::Query { after });
    let [Event::Sent(to, page)] = &events[..] else {
        panic!("{events:?}");
    };
    assert_eq!(*to, node);
    assert!(encode_to_node(page).len() <= DATAGRAM_MAX);
    let ToNode::Page(page) = page.clone() else {
        panic!("{page:?} is not a page");
    };
    page
}

const NODES: u64 = 5;
const INTERFACES: u64 = 90;

fn contract(interface: u64) -> Contract {
    let long = "x".repeat(200);
    let types = [data(&format!("{long}/A")), data(&format!("{long}/B"))];
    server(&format!("{long}/{interface}"), &types[0], &types[1])
}

/// Some nodes with interfaces 2, 4, 6, … each, and all items in order.
fn domain() -> (Bench, Vec<Item>) {
    let mut bench = Bench::new(Limits::default());
    let limits = Limits::default();
    let mut items = vec![Item::Domain {
        limits: limits.into(),
    }];
    for number in 1..=NODES {
        let text = format!("node-{number}");
        let node = bench.node(1000, &text);
        // A connection that has not greeted is not shown.
        bench.connect(1000);
        items.push(Item::Node {
            node,
            name: name(&text),
            uid: 1000,
            pid: 100 + i32::try_from(node.0).expect("small"),
            resuming: false,
            max_links: None,
        });
        for interface in 1..=INTERFACES {
            let contract = contract(interface);
            bench.declared(node, 2 * interface, &contract);
            let entity = at(node.0, 2 * interface);
            items.push(Item::Interface { entity, contract });
        }
    }
    others(&mut bench, &mut items);
    (bench, items)
}

fn at(node: u64, interface: u64) -> EntityId {
    let (node, interface) = (NodeId(node), InterfaceId(interface));
    EntityId { node, interface }
}

/// Two nodes with an item of each other kind.
fn others(bench: &mut Bench, items: &mut Vec<Item>) {
    let node = bench.node(1000, "linked");
    let offers = publisher("scan", &data("Scan"));
    let demands = subscriber("scan", None);
    let wrong = publisher("scan", &data("Image"));
    bench.declared(node, 1, &demands);
    bench.declared(node, 2, &demands);
    let links = bench.declared(node, 4, &offers);
    bench.unlinked(node, 2, links[1]);
    bench.declare(node, 5, &wrong);
    let back = bench.connect(1000);
    bench.send(back, &resuming("back"));
    bench.declare(back, 1, &subscriber("map", None));
    let claimed = LinkId {
        epoch: EPOCH + 1,
        serial: 7,
    };
    bench.send(back, &claim(1, claimed, 9));
    let named = |node: NodeId, text, resuming| Item::Node {
        node,
        name: name(text),
        uid: 1000,
        pid: 100 + i32::try_from(node.0).expect("small"),
        resuming,
        max_links: None,
    };
    let interface = |node: NodeId, interface, contract: &Contract| Item::Interface {
        entity: at(node.0, interface),
        contract: contract.clone(),
    };
    items.extend([
        named(node, "linked", false),
        interface(node, 1, &demands),
        interface(node, 2, &demands),
        interface(node, 4, &offers),
        Item::Refusal {
            entity: at(node.0, 5),
            contract: wrong,
            reason: Refusal::TopicType {
                theirs: data("Scan"),
            },
        },
        named(back, "back", true),
        interface(back, 1, &subscriber("map", None)),
        Item::Link {
            link: links[0],
            offering: at(node.0, 4),
            demanding: at(node.0, 1),
            version: 1,
            reliable: false,
            sealed: false,
        },
        Item::Claim {
            link: claimed,
            entity: at(back.0, 1),
        },
        Item::Unlinked {
            offering: at(node.0, 4),
            demanding: at(node.0, 2),
            reason: UnlinkedReason::Ended { code: Code(5) },
        },
    ]);
}

//= SM2-IFC-007, SM2-TRN-004 test
#[test]
fn pages_together_are_the_domain() {
    let (mut bench, expected) = domain();
    let mut items = Vec::new();
    let mut after = None;
    let mut pages = 0;
    loop {
        let page = query(&mut bench, NodeId(1), after);
        assert_eq!(page.revision, bench.manager.revision());
        items.extend(page.items);
        pages += 1;
        after = page.next;
        if after.is_none() {
            break;
        }
        assert_eq!(after, items.last().map(Item::key));
    }
    assert_eq!(items, expected);
    let least = expected.len() * 600 / PAGE_BYTES;
    assert!(pages > least && pages < 2 * least + 2, "{pages} pages");
}

//= SM2-IFC-007 test
#[test]
fn a_page_starts_after_any_position() {
    let (mut bench, expected) = domain();
    let around = |key: Key| {
        let Key::Member { entity } = key else {
            return vec![key];
        };
        let EntityId { node, interface } = entity;
        let nearby = |it: u64| at(node.0, it);
        [
            entity,
            nearby(interface.0 + 1),
            nearby(u64::MAX),
            at(node.0 + 1, 0),
        ]
        .map(|entity| Key::Member { entity })
        .to_vec()
    };
    let nowhere = LinkId {
        epoch: 0,
        serial: 0,
    };
    let last = at(u64::MAX, u64::MAX);
    // Keys that no item has, at the beginning and at the end of each kind.
    let strange = [at(0, 0), last].into_iter().flat_map(|entity| {
        [
            Key::Member { entity },
            Key::Link {
                link: nowhere,
                offering: entity,
            },
            Key::Claim {
                link: nowhere,
                entity,
            },
            Key::Unlinked {
                offering: entity,
                demanding: entity,
            },
        ]
    });
    let keys = expected.iter().map(Item::key).flat_map(around);
    for cursor in keys.chain(strange) {
        let page = query(&mut bench, NodeId(1), Some(cursor));
        let rest = expected.iter().filter(|item| item.key() > cursor);
        let rest: Vec<Item> = rest.cloned().collect();
        assert!(rest.starts_with(&page.items), "after {cursor:?}");
        let all = page.items.len() == rest.len();
        assert_eq!(page.next.is_none(), all, "after {cursor:?}");
        assert!(!page.items.is_empty() || rest.is_empty());
    }
}

/// A change between two pages changes the revision.
//= SM2-IFC-007 test
#[test]
fn a_change_between_pages_shows() {
    let (mut bench, _) = domain();
    let first = query(&mut bench, NodeId(1), None);
    bench.withdraw(NodeId(1), 2);
    let second = query(&mut bench, NodeId(1), first.next);
    assert!(second.revision > first.revision);
    // Events that no page shows do not change it: a connection, and a greeting that is refused.
    let stranger = bench.connect(1000);
    bench.hello(stranger, "node-1");
    bench.close(stranger);
    bench.declare(NodeId(1), 999, &publisher("t", &data("T")));
    let third = query(&mut bench, NodeId(1), first.next);
    assert_eq!(third.revision, second.revision + 1);
}
