//! Work that is done in parts: how much one input does, what other sessions see between two parts,
//! and that nothing is lost or done twice. Work is counted in outputs, not in time.

// Shows MGR-PACE (test), bound: 9 histories, counted, not timed.

use crate::support::{
    bench::{Bench, Event, UNLIMITED, claim, resuming, seen_by, unlink, unlinked},
    contracts::{data, publisher, scan, subscriber},
};
use sm2_proto::{
    Code, Farewell, InterfaceId, LinkId, Machine, NodeId,
    control::{Item, Limit, Limits, Page, ToManager, ToNode},
    manager::{Cause, Input},
};

/// Two links are made in one part, or eight of them end. The first part of a DECLARE makes eight.
const LIMITS: Limits = UNLIMITED.with(Limit::WorkPerTurn, 128);
const LINKS_PER_PART: usize = 2;
const LINKS_AT_ONCE: usize = 8;
const ENDS_PER_PART: usize = 8;
const PEERS: u64 = 50;

/// Sessions with one publisher each.
fn peers(bench: &mut Bench) -> Vec<NodeId> {
    let peer = |at| {
        let node = bench.node(1, &format!("peer{at}"));
        assert_eq!(bench.declared(node, 1, &scan()), []);
        node
    };
    (0..PEERS).map(peer).collect()
}

/// Feeds ticks until no work is left. No tick does more than one part.
fn finish(bench: &mut Bench, most: usize) -> Vec<Event> {
    let mut events = Vec::new();
    while bench.manager.deadline() == Some(bench.now) {
        let part = bench.input(Input::Tick);
        assert!(part.len() <= most, "{} outputs", part.len());
        events.extend(part);
    }
    events
}

fn links(events: &[Event]) -> Vec<LinkId> {
    let link = |event: &Event| match event {
        Event::Linked(link, _) => Some(*link),
        _ => None,
    };
    events.iter().filter_map(link).collect()
}

/// A subscriber that is linked with each peer, in its own session.
fn linked(bench: &mut Bench) -> (NodeId, Vec<NodeId>) {
    let peers = peers(bench);
    let node = bench.node(1, "many");
    bench.declare(node, 1, &subscriber("scan", None));
    finish(bench, LINKS_PER_PART);
    assert_eq!(bench.manager.links(), peers.len());
    (node, peers)
}

fn items(bench: &mut Bench, node: NodeId) -> Vec<Item> {
    let events = bench.send(node, &ToManager::Query { after: None });
    match &events[..] {
        [Event::Sent(_, ToNode::Page(Page { items, .. }))] => items.clone(),
        other => panic!("{other:?}"),
    }
}

//= SM2-SES-009, SM2-IFC-002, SM2-MAT-002 test
#[test]
fn a_declare_with_many_matches_is_cut() {
    let mut bench = Bench::new(LIMITS);
    let peers = peers(&mut bench);
    let node = bench.node(1, "many");
    let first = bench.declared(node, 1, &subscriber("scan", None));
    assert_eq!(first.len(), LINKS_AT_ONCE, "DECLARED counts one part");
    assert!(bench.manager.is_busy(node));
    // Others are served in between: one is new, one ends its link, and one goes.
    let late = bench.node(1, "late");
    assert_eq!(bench.declared(late, 1, &scan()).len(), 1);
    assert!(!bench.manager.is_busy(late));
    let ended = bench.unlinked(peers[0], 1, first[0]);
    assert_eq!(seen_by(&ended, node), [unlink(1, first[0], 5)]);
    bench.close(peers[PEERS as usize - 1]);
    let rest = finish(&mut bench, LINKS_PER_PART);
    assert!(!bench.manager.is_busy(node));
    // Neither the pair that ended its link nor the one that is linked already is linked again.
    assert_eq!(links(&rest).len(), peers.len() - LINKS_AT_ONCE - 1);
    assert_eq!(bench.manager.links(), peers.len() - 1);
}

/// A frame that the driver feeds too early is handled after the frame before.
//= SM2-SES-009 test
#[test]
fn frames_are_handled_in_their_order() {
    let mut bench = Bench::new(LIMITS);
    let peers = peers(&mut bench);
    let node = bench.node(1, "many");
    bench.declare(node, 1, &subscriber("scan", None));
    assert!(bench.manager.is_busy(node));
    let events = bench.withdraw(node, 1);
    assert_eq!(links(&events).len(), peers.len() - LINKS_AT_ONCE);
    let withdrawn = ToNode::Withdrawn {
        interface: InterfaceId(1),
    };
    assert_eq!(seen_by(&events, node).last(), Some(&withdrawn));
    let own = finish(&mut bench, ENDS_PER_PART);
    assert_eq!(seen_by(&own, node), [], "the interface is not named again");
    assert_eq!(bench.manager.links(), 0);
}

//= SM2-SES-009, SM2-IFC-003, SM2-LNK-003 test
#[test]
fn a_withdraw_with_many_links_is_cut() {
    let mut bench = Bench::new(LIMITS);
    let (node, peers) = linked(&mut bench);
    let events = bench.withdraw(node, 1);
    assert_eq!(events.len(), ENDS_PER_PART + 1, "WITHDRAWN is the last one");
    assert!(bench.manager.is_busy(node));
    // The interface is gone at once, its links are not.
    let watcher = peers[0];
    let shown = items(&mut bench, watcher);
    let interface =
        |it: &&Item| matches!(it, Item::Interface { entity, .. } if entity.node == node);
    assert_eq!(shown.iter().filter(interface).count(), 0);
    let link = |it: &Item| match it {
        Item::Link { link, offering, .. } => Some((*link, *offering)),
        _ => None,
    };
    let left: Vec<_> = shown.iter().filter_map(link).collect();
    assert_eq!(left.len(), peers.len() - ENDS_PER_PART);
    // The other side may say farewell first, withdraw its interface, or go.
    let [one, two, three] = [0, 1, 2].map(|at| left[at]);
    let answer = bench.send(one.1.node, &unlinked(1, one.0));
    assert_eq!(answer, [Event::Sent(one.1.node, unlink(1, one.0, 5))]);
    assert_eq!(bench.withdraw(two.1.node, 1).len(), 1);
    assert_eq!(bench.close(three.1.node).len(), 1);
    let rest = finish(&mut bench, ENDS_PER_PART);
    assert_eq!(rest.len(), left.len() - 3, "one UNLINK for each");
    assert_eq!(seen_by(&rest, node), []);
    assert_eq!(bench.manager.links(), 0);
    // A pair of an interface that is gone is not remembered.
    let unlinked = |it: &Item| matches!(it, Item::Unlinked { .. });
    assert!(!items(&mut bench, watcher).iter().any(unlinked));
}

//= SM2-SES-009, SM2-SES-006, SM2-SES-003 test
#[test]
fn the_end_of_a_session_with_many_links_is_cut() {
    let mut bench = Bench::new(LIMITS);
    let (node, peers) = linked(&mut bench);
    let events = bench.close(node);
    assert_eq!(events.len(), ENDS_PER_PART + 1);
    assert_eq!(
        events.last(),
        Some(&Event::HungUp(node, None, Cause::Gone)),
        "the connection is closed at once"
    );
    // Its name is free, and a successor is linked.
    let again = bench.node(1, "many");
    assert_eq!(
        bench.declared(again, 1, &subscriber("scan", None)).len(),
        LINKS_AT_ONCE
    );
    let rest = finish(&mut bench, ENDS_PER_PART);
    let unlinks = |it: &&Event| matches!(it, Event::Sent(_, ToNode::Unlink { .. }));
    assert_eq!(
        rest.iter().filter(unlinks).count(),
        peers.len() - ENDS_PER_PART
    );
    assert_eq!(bench.manager.links(), peers.len());
}

//= SM2-SES-009, SM2-LNK-006 test
#[test]
fn a_link_that_nobody_was_told_of_ends_in_silence() {
    let limits = LIMITS.with(Limit::LinksInFlight, 1);
    let mut bench = Bench::new(limits);
    let peers = peers(&mut bench);
    let node = bench.node(1, "many");
    bench.declare(node, 1, &subscriber("scan", None));
    finish(&mut bench, LINKS_PER_PART);
    assert_eq!(bench.manager.links(), peers.len());
    bench.withdraw(node, 1);
    // The session has room again, but its interface is gone.
    assert_eq!(bench.input(Input::Drained { session: node }), []);
    assert_eq!(finish(&mut bench, 0), []);
    assert_eq!(bench.manager.links(), 0);
}

//= SM2-SES-009, SM2-LNK-006 test
#[test]
fn links_that_waited_for_room_are_announced_in_parts() {
    let limits = LIMITS.with(Limit::LinksInFlight, 30);
    let mut bench = Bench::new(limits);
    let peers = peers(&mut bench);
    let node = bench.node(1, "many");
    let mut made = bench.declared(node, 1, &subscriber("scan", None));
    made.extend(links(&finish(&mut bench, LINKS_PER_PART)));
    assert_eq!(made.len(), 30);
    assert_eq!(bench.input(Input::Drained { session: node }), []);
    made.extend(links(&finish(&mut bench, LINKS_PER_PART)));
    assert_eq!(made.len(), peers.len());
    assert!(made.is_sorted(), "the oldest first");
}

//= SM2-SES-009, SM2-RES-006 test
#[test]
fn claims_that_nobody_shares_are_given_up_in_parts() {
    let mut bench = Bench::new(LIMITS);
    let node = bench.connect(1);
    bench.send(node, &resuming("back"));
    bench.declare(node, 1, &scan());
    for serial in 1..=PEERS {
        let link = LinkId { epoch: 7, serial };
        assert_eq!(bench.send(node, &claim(1, link, serial)), []);
    }
    bench.send(node, &ToManager::Claimed);
    bench.now = bench.manager.deadline().expect("the claims expire");
    let mut told = bench.input(Input::Tick);
    assert_eq!(told.len(), ENDS_PER_PART);
    assert!(bench.manager.is_busy(node));
    told.extend(finish(&mut bench, ENDS_PER_PART));
    let code = Farewell::PeerGone.code();
    let gone = |event: &Event| matches!(event, Event::Sent(_, ToNode::Unlink { code: it, .. }) if *it == code);
    assert!(told.iter().all(gone) && told.len() == PEERS as usize);
    assert_eq!(bench.manager.deadline(), None);
}

/// A session that is busy costs another busy one a part each time, and no more.
//= SM2-SES-009 test
#[test]
fn busy_sessions_take_turns() {
    let mut bench = Bench::new(LIMITS);
    peers(&mut bench);
    let both = ["one", "two"].map(|it| bench.node(1, it));
    for node in both {
        bench.declare(node, 1, &subscriber("scan", None));
    }
    let mut told = [LINKS_AT_ONCE; 2];
    while bench.manager.deadline() == Some(bench.now) {
        let part = bench.input(Input::Tick);
        for (count, node) in told.iter_mut().zip(both) {
            *count += seen_by(&part, node).len();
        }
        assert!(told[0].abs_diff(told[1]) <= LINKS_PER_PART, "{told:?}");
    }
    assert_eq!(told, [PEERS as usize; 2]);
}

/// Sessions that declare and withdraw without pause, with many matches each, delay a session that was quiet by a few
/// parts, not by one part each for each of its own.
//= SM2-SES-009 test
#[test]
fn a_quiet_session_goes_before_busy_ones() {
    const BUSY: u64 = 20;
    let mut bench = Bench::new(LIMITS);
    peers(&mut bench);
    let quiet = bench.node(1, "quiet");
    let topic = |at: u64| format!("busy{at}");
    let mut busy: Vec<(NodeId, u64)> = Vec::new();
    for at in 0..BUSY {
        let crowd = bench.node(1, &format!("crowd{at}"));
        for interface in 1..=PEERS {
            bench.declare(crowd, interface, &subscriber(&topic(at), None));
        }
        busy.push((bench.node(1, &format!("busy{at}")), 0));
    }
    finish(&mut bench, LINKS_AT_ONCE);
    let mut turn = |bench: &mut Bench| {
        for (at, (node, interface)) in (0..).zip(&mut busy) {
            if !bench.manager.is_busy(*node) {
                if *interface > 0 {
                    bench.withdraw(*node, *interface);
                }
                *interface += 1;
                let contract = publisher(&topic(at), &data("data"));
                bench.declare(*node, *interface, &contract);
            }
        }
        bench.input(Input::Tick);
    };
    for _ in 0..200 * BUSY {
        turn(&mut bench);
    }
    bench.declare(quiet, 1, &subscriber("scan", None));
    let mut turns = 0;
    while bench.manager.is_busy(quiet) {
        turn(&mut bench);
        turns += 1;
    }
    let own = (PEERS as usize - LINKS_AT_ONCE).div_ceil(LINKS_PER_PART);
    assert!(turns <= 2 * own, "{turns} parts for {own} of its own");
}

/// A Manager that ends leaves nothing to be done.
//= SM2-SES-008, SM2-SES-009 test
#[test]
fn a_shutdown_leaves_no_work() {
    let mut bench = Bench::new(LIMITS);
    let (node, peers) = linked(&mut bench);
    bench.withdraw(node, 1);
    let events = bench.input(Input::Shutdown);
    let goodbye = |event: &Event| matches!(event, Event::HungUp(_, Some(Code(_)), _));
    assert!(events.iter().all(goodbye) && events.len() == peers.len() + 1);
    assert_eq!(bench.manager.deadline(), None);
    assert_eq!(bench.manager.links(), 0);
}
