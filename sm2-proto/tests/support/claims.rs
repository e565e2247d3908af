//! Sessions that come back with a link of an earlier Manager.
#![allow(dead_code, reason = "each test uses a part")]

use sm2_proto::{
    Contract, EntityId, InterfaceId, LinkId, NodeId, Violation,
    control::{Item, Limits, Page, ToManager, ToNode},
    manager::Cause,
};

use crate::support::{
    bench::{Bench, EPOCH, Event, resuming},
    contracts::{scan, subscriber},
};

/// A link that an earlier Manager made.
pub(crate) const LINK: LinkId = LinkId {
    epoch: EPOCH - 1,
    serial: 3,
};
pub(crate) const KEY: u64 = 0xBADC_0FFE;
pub(crate) const OFFERING: u64 = 1;
pub(crate) const DEMANDING: u64 = 2;

pub(crate) fn entity(node: NodeId, interface: u64) -> EntityId {
    let interface = InterfaceId(interface);
    EntityId { node, interface }
}

pub(crate) fn wanted() -> Contract {
    subscriber("scan", None)
}

/// A session that has come back and has declared these interfaces again.
pub(crate) fn back(bench: &mut Bench, text: &str, interfaces: &[(u64, Contract)]) -> NodeId {
    back_as(bench, 1, text, interfaces)
}

pub(crate) fn back_as(
    bench: &mut Bench,
    uid: u32,
    text: &str,
    interfaces: &[(u64, Contract)],
) -> NodeId {
    let node = bench.connect(uid);
    let events = bench.send(node, &resuming(text));
    assert!(
        matches!(events[..], [Event::Sent(_, ToNode::Welcome { .. })]),
        "{events:?}"
    );
    for (interface, contract) in interfaces {
        assert_eq!(bench.declared(node, *interface, contract), []);
    }
    node
}

pub(crate) fn claimed(bench: &mut Bench, node: NodeId) -> Vec<Event> {
    bench.send(node, &ToManager::Claimed)
}

/// Both ends of LINK are back, in sessions of their own; nothing is claimed.
pub(crate) fn both_back(limits: Limits) -> (Bench, NodeId, NodeId) {
    let mut bench = Bench::new(limits);
    let a = back(&mut bench, "a", &[(OFFERING, scan())]);
    let b = back(&mut bench, "b", &[(DEMANDING, wanted())]);
    (bench, a, b)
}

pub(crate) fn items(bench: &Bench, asks: NodeId) -> Vec<Item> {
    let mut aside = bench.clone();
    let events = aside.send(asks, &ToManager::Query { after: None });
    match &events[..] {
        [Event::Sent(_, ToNode::Page(Page { items, .. }))] => items.clone(),
        other => panic!("{other:?}"),
    }
}

/// The links, claims and unlinked pairs that a node sees.
pub(crate) fn relations(bench: &Bench, asks: NodeId) -> Vec<Item> {
    let mut items = items(bench, asks);
    items.retain(|item| {
        matches!(
            item,
            Item::Link { .. } | Item::Claim { .. } | Item::Unlinked { .. }
        )
    });
    items
}

pub(crate) fn link_item(link: LinkId, offering: EntityId, demanding: EntityId) -> Item {
    Item::Link {
        link,
        offering,
        demanding,
        version: 1,
        reliable: false,
        sealed: false,
    }
}

pub(crate) fn violation(bench: &mut Bench, node: NodeId, frame: &ToManager) -> Violation {
    match bench.send(node, frame).last() {
        Some(Event::HungUp(session, Some(_), Cause::Violation(it))) if *session == node => *it,
        other => panic!("{other:?}"),
    }
}

pub(crate) fn links_made(events: &[Event]) -> Vec<(LinkId, [(NodeId, InterfaceId); 2])> {
    let ends = |ends: &[(NodeId, ToNode); 2]| {
        [&ends[0], &ends[1]].map(|(node, frame)| match frame {
            ToNode::Link { interface, .. } => (*node, *interface),
            other => panic!("{other:?} is no LINK"),
        })
    };
    let links = events.iter().filter_map(|event| match event {
        Event::Linked(link, frames) => Some((*link, ends(frames))),
        _ => None,
    });
    links.collect()
}
