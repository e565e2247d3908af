//! QUERY: a domain larger than a datagram, read a page at a time.

mod support;

use sm2_proto::{
    Contract, InterfaceId, NodeId,
    control::{Cursor, Item, ToManager, ToNode, encode_to_node},
    limits::{DATAGRAM_MAX, PAGE_BYTES},
    manager::Policy,
};
use support::{
    bench::{Bench, Event},
    contracts::{data, name, publisher, server},
};

struct Page {
    revision: u64,
    items: Vec<Item>,
    next: Option<Cursor>,
}

fn query(bench: &mut Bench, node: NodeId, after: Option<Cursor>) -> Page {
    let events = bench.send(node, &ToManager::Query { after });
    let [Event::Sent(to, page)] = &events[..] else {
        panic!("{events:?}");
    };
    assert_eq!(*to, node);
    assert!(encode_to_node(page).len() <= DATAGRAM_MAX);
    let ToNode::Page {
        revision,
        items,
        next,
    } = page.clone()
    else {
        panic!("{page:?} is no page");
    };
    Page {
        revision,
        items,
        next,
    }
}

fn position(item: &Item) -> Cursor {
    match *item {
        Item::Node { node, .. } => Cursor {
            node,
            interface: InterfaceId(0),
        },
        Item::Interface {
            node, interface, ..
        } => Cursor { node, interface },
    }
}

const NODES: u64 = 5;
const INTERFACES: u64 = 90;

fn contract(interface: u64) -> Contract {
    let long = "x".repeat(200);
    let types = [data(&format!("{long}/A")), data(&format!("{long}/B"))];
    server(&format!("{long}/{interface}"), &types[0], &types[1])
}

/// Some nodes, with interfaces 2, 4, 6, … each; and all of it in order.
fn domain() -> (Bench, Vec<Item>) {
    let mut bench = Bench::new(Policy::default());
    let mut items = Vec::new();
    for at in 1..=NODES {
        let text = format!("node-{at}");
        let node = bench.node(1000, &text);
        // A connection that does not greet is not shown.
        bench.connect(1000);
        items.push(Item::Node {
            node,
            name: name(&text),
            uid: 1000,
            pid: 100 + i32::try_from(node.0).expect("small"),
        });
        for interface in 1..=INTERFACES {
            let contract = contract(interface);
            bench.declared(node, 2 * interface, &contract);
            items.push(Item::Interface {
                node,
                interface: InterfaceId(2 * interface),
                contract,
                links: 0,
            });
        }
    }
    (bench, items)
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
        assert_eq!(after, items.last().map(position));
    }
    assert_eq!(items, expected);
    let least = expected.len() * 600 / PAGE_BYTES;
    assert!(pages > least && pages < 2 * least + 2, "{pages} pages");
}

//= SM2-IFC-007 test
#[test]
fn a_page_starts_after_any_position() {
    let (mut bench, expected) = domain();
    let around = |cursor: Cursor| {
        let Cursor { node, interface } = cursor;
        let nearby = |it: u64| Cursor {
            node,
            interface: InterfaceId(it),
        };
        [
            cursor,
            nearby(interface.0 + 1),
            nearby(u64::MAX),
            Cursor {
                node: NodeId(node.0 + 1),
                interface: InterfaceId(0),
            },
        ]
    };
    for cursor in expected.iter().map(position).flat_map(around) {
        let page = query(&mut bench, NodeId(1), Some(cursor));
        let rest = expected.iter().filter(|item| position(item) > cursor);
        let rest: Vec<Item> = rest.cloned().collect();
        assert!(rest.starts_with(&page.items), "after {cursor:?}");
        let all = page.items.len() == rest.len();
        assert_eq!(page.next.is_none(), all, "after {cursor:?}");
        assert!(!page.items.is_empty() || rest.is_empty());
    }
    let end = Cursor {
        node: NodeId(u64::MAX),
        interface: InterfaceId(u64::MAX),
    };
    let page = query(&mut bench, NodeId(1), Some(end));
    assert!(page.items.is_empty() && page.next.is_none());
}

/// What changes between two pages changes the revision.
//= SM2-IFC-007 test
#[test]
fn a_change_between_pages_shows() {
    let (mut bench, _) = domain();
    let first = query(&mut bench, NodeId(1), None);
    bench.withdraw(NodeId(1), 2);
    let second = query(&mut bench, NodeId(1), first.next);
    assert!(second.revision > first.revision);
    // What no page shows does not: a connection, and a greeting that is refused.
    let stranger = bench.connect(1000);
    bench.hello(stranger, "node-1");
    bench.close(stranger);
    bench.declare(NodeId(1), 999, &publisher("t", &data("T")));
    let third = query(&mut bench, NodeId(1), first.next);
    assert_eq!(third.revision, second.revision + 1);
}
