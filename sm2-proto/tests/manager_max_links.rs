//! A node states how many ends of links it can have (MAX_LINKS). The Manager holds further links
//! back, and makes them as soon as there is room.

// Shows MGR-PACE (test), bound: 9 histories, counted, not timed.

use crate::support::{
    bench::{Bench, EPOCH, Event, UNLIMITED, claim, resuming, seen_by, unlink, unlinked},
    contracts::{client, data, scan, server, subscriber},
    items::at,
};
use sm2_proto::{
    Contract, LinkId, Machine, NodeId,
    control::{Change, Item, Limits, ToManager, ToNode},
    domain::Domain,
    manager::Input,
};

fn max_links(max_links: u32) -> ToManager {
    ToManager::MaxLinks { max_links }
}

fn made(events: &[Event]) -> Vec<u64> {
    let serial = |event: &Event| match event {
        Event::Linked(link, _) => Some(link.serial),
        _ => None,
    };
    events.iter().filter_map(serial).collect()
}

/// The links that the deferred work makes.
fn all_outputs(bench: &mut Bench) -> Vec<u64> {
    let mut all = Vec::new();
    while bench.manager.deadline() == Some(bench.now) {
        all.extend(made(&bench.input(Input::Tick)));
    }
    all
}

fn link(serial: u64) -> LinkId {
    LinkId {
        epoch: EPOCH,
        serial,
    }
}

fn domain(bench: &mut Bench, asks: NodeId) -> Domain {
    let page = bench.send(asks, &ToManager::Query { after: None });
    match &page[..] {
        [Event::Sent(_, ToNode::Page(page))] => {
            let mut domain = Domain::default();
            domain.page(page.items.clone());
            domain
        }
        other => panic!("{other:?}"),
    }
}

fn waiting(bench: &mut Bench, asks: NodeId) -> usize {
    let domain = domain(bench, asks);
    domain.waiting_links().count()
}

/// A publisher's node with `publishers` publishers, and a node that has room for `room` links.
fn scene(limits: Limits, publishers: u64, room: u32) -> (Bench, NodeId, NodeId, Vec<u64>) {
    let mut bench = Bench::new(limits);
    let talker = bench.node(1, "talker");
    for interface in 1..=publishers {
        bench.declared(talker, interface, &scan());
    }
    let listener = bench.node(1, "listener");
    assert_eq!(bench.send(listener, &max_links(room)), []);
    let events = bench.declare(listener, 1, &subscriber("scan", None));
    let matches = events.iter().find_map(|it| match it {
        Event::Sent(_, ToNode::Declared { matches, .. }) => Some(*matches),
        _ => None,
    });
    let made = made(&events);
    assert_eq!(
        matches,
        Some(made.len() as u32),
        "only what comes is announced"
    );
    (bench, talker, listener, made)
}

//= SM2-LNK-007 test
#[test]
fn links_beyond_the_room_of_a_node_wait_until_others_end() {
    let (mut bench, talker, listener, at_once) = scene(UNLIMITED, 6, 3);
    assert_eq!(at_once, [1, 2, 3]);
    assert_eq!(bench.manager.links(), 6, "the others wait");
    assert_eq!(bench.manager.deadline(), None, "for room, not for a time");
    assert_eq!(waiting(&mut bench, listener), 3);
    // The end at the other side is not enough: this node still has the link.
    bench.withdraw(talker, 1);
    assert_eq!(all_outputs(&mut bench), [0; 0]);
    bench.unlinked(listener, 1, link(1));
    assert_eq!(
        all_outputs(&mut bench),
        [4],
        "the oldest first, and no more than fits"
    );
    // The node itself ends a link, before it is asked to.
    let events = bench.unlinked(listener, 1, link(3));
    assert_eq!(seen_by(&events, listener), [unlink(1, link(3), 5)]);
    assert_eq!(all_outputs(&mut bench), [5]);
    assert_eq!(waiting(&mut bench, listener), 1);
}

//= SM2-LNK-007 test
#[test]
fn max_links_changes_the_room_and_ends_nothing() {
    let (mut bench, _, listener, at_once) = scene(UNLIMITED, 6, 2);
    assert_eq!(at_once, [1, 2]);
    assert_eq!(bench.send(listener, &max_links(0)), [], "no link ends");
    bench.send(listener, &max_links(4));
    assert_eq!(all_outputs(&mut bench), [3, 4]);
    bench.send(listener, &max_links(3));
    bench.unlinked(listener, 1, link(1));
    assert_eq!(
        all_outputs(&mut bench),
        [0; 0],
        "it has three, which is all that it can have"
    );
    bench.send(listener, &max_links(u32::MAX));
    assert_eq!(all_outputs(&mut bench), [5, 6]);
    let domain = domain(&mut bench, listener);
    let stated = domain.node(listener).expect("it is there").max_links;
    assert_eq!(stated, Some(u32::MAX));
}

/// WITHDRAW replaces the farewells of all links of the interface.
//= SM2-LNK-007, SM2-IFC-003 test
#[test]
fn a_withdrawn_interface_leaves_room_for_others() {
    let (mut bench, talker, listener, _) = scene(UNLIMITED, 4, 3);
    let events = bench.declare(listener, 2, &subscriber("scan", None));
    assert_eq!(made(&events), [0; 0]);
    let mut all = made(&bench.withdraw(listener, 1));
    all.extend(all_outputs(&mut bench));
    assert_eq!(
        all,
        [5, 6, 7],
        "the waiting link of the interface is gone, too"
    );
    // Only links that the node knows count: one that waits leaves no room.
    bench.withdraw(talker, 4);
    assert_eq!(all_outputs(&mut bench), [0; 0]);
    assert_eq!(bench.manager.links(), 3);
}

/// A link of a session with itself has two ends there.
//= SM2-LNK-007 test
#[test]
fn a_link_with_itself_needs_room_for_both_ends() {
    let mut bench = Bench::new(UNLIMITED);
    let one = bench.node(1, "one");
    bench.send(one, &max_links(3));
    bench.declared(one, 1, &scan());
    assert_eq!(bench.declared(one, 2, &subscriber("scan", None)).len(), 1);
    let events = bench.declare(one, 3, &subscriber("scan", None));
    assert_eq!(made(&events), [0; 0], "one end would fit");
    bench.send(one, &max_links(4));
    assert_eq!(all_outputs(&mut bench), [2]);
}

/// Both sides need room, and a node without room holds up no other pair.
//= SM2-LNK-007 test
#[test]
fn a_full_node_holds_up_no_other() {
    let mut bench = Bench::new(UNLIMITED);
    let (data, reply) = (data("Ask"), data("Answer"));
    let full = bench.node(1, "full");
    bench.send(full, &max_links(1));
    bench.declared(full, 1, &server("add", &data, &reply));
    let free = bench.node(1, "free");
    bench.declared(free, 1, &server("add", &data, &reply));
    let mut serials = Vec::new();
    let asks: Vec<NodeId> = (0..3)
        .map(|it| bench.node(1, &format!("asks-{it}")))
        .collect();
    for &node in &asks {
        let events = bench.declare(node, 1, &client("add", None));
        serials.push(made(&events));
    }
    assert_eq!(serials, [vec![1, 2], vec![4], vec![6]]);
    // A client without room waits for its own room as well.
    bench.send(asks[1], &max_links(1));
    bench.send(full, &max_links(9));
    assert_eq!(all_outputs(&mut bench), [5]);
    bench.send(asks[1], &max_links(2));
    assert_eq!(all_outputs(&mut bench), [3]);
}

/// A driver without descriptors for a socket pair: neither node has the link.
//= SM2-LNK-008, SM2-LNK-007 test
#[test]
fn a_link_that_could_not_be_made_takes_no_room() {
    let (mut bench, _, listener, _) = scene(UNLIMITED, 3, 1);
    bench.unlinked(listener, 1, link(1));
    assert_eq!(all_outputs(&mut bench), [2]);
    assert_eq!(bench.input(Input::LinkFailed { link: link(2) }), []);
    assert_eq!(all_outputs(&mut bench), [3], "the next one takes its place");
    bench.send(listener, &max_links(2));
    bench.now = bench.manager.deadline().expect("another attempt");
    assert_eq!(all_outputs(&mut bench), [4]);
}

/// Claims count beyond the room, and do not end for it.
//= SM2-LNK-007, SM2-RES-004 test
#[test]
fn links_of_an_earlier_manager_go_on_beyond_the_room() {
    let mut bench = Bench::new(UNLIMITED);
    let old = |serial| LinkId {
        epoch: EPOCH + 1,
        serial,
    };
    let back = |bench: &mut Bench, text, contract: &Contract| {
        let node = bench.connect(1);
        bench.send(node, &resuming(text));
        bench.send(node, &max_links(1));
        for interface in 1..=2 {
            bench.declared(node, interface, contract);
            bench.send(node, &claim(interface, old(interface), interface));
        }
        node
    };
    let talker = back(&mut bench, "talker", &scan());
    let listener = back(&mut bench, "listener", &subscriber("scan", None));
    let mut events = Vec::new();
    for node in [talker, listener] {
        events.extend(bench.send(node, &ToManager::Claimed));
    }
    assert_eq!(made(&events), [0; 0], "the two other pairs wait");
    assert_eq!(seen_by(&events, listener), [], "and nothing ends");
    assert_eq!(
        (all_outputs(&mut bench), bench.manager.links()),
        (vec![], 4)
    );
    bench.unlinked(listener, 1, old(1));
    bench.unlinked(talker, 1, old(1));
    assert_eq!(
        all_outputs(&mut bench),
        [0; 0],
        "it still has one, which is all that it can have"
    );
    for node in [talker, listener] {
        bench.send(node, &max_links(3));
    }
    assert_eq!(all_outputs(&mut bench), [1, 2]);
}

/// Nobody knows a link that waits: its number can only have been guessed.
//= SM2-LNK-007, SM2-LNK-003 test
#[test]
fn the_domain_shows_the_node_without_room() {
    let (mut bench, talker, listener, _) = scene(UNLIMITED, 2, 1);
    let domain_now = domain(&mut bench, listener);
    assert_eq!(domain_now.known_ends(listener), 1);
    let shown = domain_now.node(listener).expect("it is a node");
    assert_eq!(shown.max_links, Some(1));
    let key = Item::Waiting {
        link: link(2),
        offering: at(talker.0, 2),
        demanding: at(listener.0, 1),
    };
    assert!(domain_now.items().any(|it| *it == key));
    let hung_up = bench.send(listener, &unlinked(1, link(2)));
    assert!(
        matches!(hung_up[..], [.., Event::HungUp(..)]),
        "{hung_up:?}"
    );
}

/// A watcher learns that a link waits no more.
//= SM2-LNK-007, SM2-WCH-002 test
#[test]
fn changes_show_the_end_of_waiting() {
    let (mut bench, _, listener, _) = scene(UNLIMITED, 2, 1);
    let watcher = bench.node(1, "watcher");
    let after = bench.manager.revision();
    bench.send(watcher, &ToManager::Watch { after });
    let mut events = bench.send(listener, &max_links(2));
    let after = bench.manager.revision();
    events.extend(bench.send(watcher, &ToManager::Watch { after }));
    events.extend(bench.input(Input::Tick));
    let links = seen_by(&events, watcher).into_iter().filter(|frame| {
        matches!(frame, ToNode::Changes(changes) if changes.changes.iter().flatten().any(|it| {
            matches!(it, Change::Set { item: Item::Link { link: shown, .. } } if *shown == link(2))
        }))
    });
    assert_eq!(links.count(), 1, "{events:?}");
}
