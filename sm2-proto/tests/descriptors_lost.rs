//! A process without a free descriptor loses those of the frames that it receives. It loses the
//! effect of these frames, and nothing else.

// Shows MGR-RETRY (test), bound: one lost descriptor for each frame that has one; 9 attempts.

use crate::support;
use crate::support::{
    bench::{Bench, Event, UNLIMITED, seen_by, unlink},
    contracts::{scan, subscriber},
    session::{NOW, drain, interface_in, link, link_id, ready, receive, sent, unlink as unlink_1},
};
use sm2_proto::{
    Code, Contract, Datagram, Farewell, FdFacts, InterfaceId, LinkId, Machine, NodeId, Seals,
    control::{Item, Limit, ToManager, ToNode, UnlinkedReason, encode_to_manager, encode_to_node},
    manager::{Cause, Input},
    node::{self, Node, Output},
    violation,
};

const MILLI: u64 = 1_000_000;
const RESOURCES: Code = Code(4);

const FILE: FdFacts = FdFacts {
    regular: true,
    size_bytes: 1_024,
    seals: Seals::POOLED,
};

/// A datagram whose descriptors this process lost in part.
fn lost(bytes: &[u8]) -> Datagram<'_> {
    Datagram {
        control_truncated: true,
        ..Datagram::new(bytes)
    }
}

fn receive_lost(node: &mut Node, frame: &ToNode) -> Vec<Output> {
    let bytes = encode_to_node(frame);
    let taken = node.handle(NOW, node::Input::Datagram(lost(&bytes)));
    taken.expect("no violation");
    drain(node)
}

fn unlinked(interface: u64, link: LinkId, code: Code) -> ToManager {
    ToManager::Unlinked {
        interface: InterfaceId(interface),
        link,
        code,
    }
}

/// The node ends the link of a LINK whose socket it lost. All else goes on.
//= SM2-TRN-011, SM2-LNK-009 test
#[test]
fn a_node_ends_the_link_whose_socket_it_lost_and_no_other() {
    let mut node = ready();
    let outputs = receive_lost(&mut node, &link(1, 2));
    let resources = Farewell::Resources.code();
    assert_eq!(
        sent(&outputs),
        [unlinked(1, link_id(2), resources)],
        "{outputs:?}"
    );
    let told = outputs.iter().any(|it| {
        matches!(it, Output::LinkLost { interface, link, .. }
            if (*interface, *link) == (InterfaceId(1), link_id(2)))
    });
    assert!(told, "{outputs:?}");
    assert_eq!(node.end(), None);
    // The Manager answers, and makes another link. The first link is as it was.
    assert_eq!(receive(&mut node, &unlink_1(1, 2)), Ok(Vec::new()));
    let linked = receive(&mut node, &link(1, 3)).expect("legal");
    assert!(matches!(linked[..], [Output::Linked { .. }]), "{linked:?}");
    let ended = receive(&mut node, &unlink_1(1, 1)).expect("legal");
    assert_eq!(sent(&ended).len(), 1);
}

//= SM2-TRN-011, SM2-IFC-004 test
#[test]
fn a_node_that_drops_the_interface_says_nothing() {
    let mut node = interface_in("dropping");
    assert_eq!(receive_lost(&mut node, &link(1, 2)), []);
    assert_eq!(receive(&mut node, &unlink_1(1, 2)), Ok(Vec::new()));
}

//= SM2-TRN-011, SM2-CNT-003 test
#[test]
fn counters_that_a_node_could_not_receive_are_none() {
    let mut node = ready();
    let of = NodeId(4);
    node.handle(NOW, node::Input::Inspect { node: of })
        .expect("ready");
    drain(&mut node);
    let outputs = receive_lost(&mut node, &ToNode::Inspected { node: of });
    assert_eq!(outputs, [Output::NotInspected { node: of }]);
}

/// COUNTERS is legal once more after one whose file the Manager could not receive.
//= SM2-TRN-011, SM2-CNT-001 test
#[test]
fn counters_that_the_manager_could_not_receive_may_come_again() {
    let mut bench = Bench::new(UNLIMITED);
    let node = bench.node(1, "a");
    let frame = encode_to_manager(&ToManager::Counters);
    assert_eq!(bench.datagram(node, lost(&frame)), []);
    let inspect = ToManager::Inspect { node };
    let none = Event::Sent(node, ToNode::NotInspected { node });
    assert_eq!(bench.send(node, &inspect), [none]);
    let whole = Datagram {
        fds: &[FILE],
        ..Datagram::new(&frame)
    };
    assert_eq!(bench.datagram(node, whole), [Event::CountersKept(node)]);
    // A frame of another type has none that could be lost.
    let query = encode_to_manager(&ToManager::Query { after: None });
    let violation = violation!(FdCount, "SM2-TRN-010");
    let hung_up = Event::HungUp(node, Some(violation.code()), Cause::Violation(violation));
    assert_eq!(bench.datagram(node, lost(&query)), [hung_up]);
}

/// The Manager asks again for counters whose file it lost, after a second.
//= SM2-CNT-002 test
#[test]
fn lost_counters_are_asked_for_again() {
    let mut bench = Bench::new(UNLIMITED);
    let (node, gone) = (bench.node(1, "a"), bench.node(1, "b"));
    let frame = encode_to_manager(&ToManager::Counters);
    let asks = Event::Sent(node, ToNode::CountersLost);
    for _ in 0..2 {
        assert_eq!(bench.datagram(node, lost(&frame)), []);
        assert_eq!(bench.datagram(gone, lost(&frame)), []);
        let at = bench.manager.deadline().expect("it asks later");
        assert_eq!(at.0 - bench.now.0, 1_000 * MILLI);
        assert_eq!(bench.input(Input::Tick), [], "not yet");
        bench.now = at;
        let asked = bench.input(Input::Tick);
        assert_eq!(
            asked,
            [asks.clone(), Event::Sent(gone, ToNode::CountersLost)]
        );
        assert_eq!(bench.manager.deadline(), None, "once each");
    }
    // Nobody is asked who has gone, or whose counters have come.
    for session in [node, gone] {
        bench.datagram(session, lost(&frame));
    }
    bench.close(gone);
    let whole = Datagram {
        fds: &[FILE],
        ..Datagram::new(&frame)
    };
    assert_eq!(bench.datagram(node, whole), [Event::CountersKept(node)]);
    bench.now = bench.now.after(std::time::Duration::from_secs(2));
    assert_eq!(bench.input(Input::Tick), []);
}

/// Two linked nodes.
fn linked() -> (Bench, NodeId, NodeId, LinkId) {
    let mut bench = Bench::new(UNLIMITED);
    let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
    bench.declared(a, 1, &scan());
    let link = bench.declared(b, 1, &subscriber("scan", None))[0];
    (bench, a, b, link)
}

fn made(events: &[Event]) -> Vec<LinkId> {
    let link = |event: &Event| match event {
        Event::Linked(link, _) => Some(*link),
        _ => None,
    };
    events.iter().filter_map(link).collect()
}

/// Advances to the deadline of the next attempt. Returns the delay in milliseconds, and the link.
fn next_attempt(bench: &mut Bench) -> (u64, Option<LinkId>) {
    let at = bench.manager.deadline().expect("another attempt");
    let delay = (at.0 - bench.now.0) / MILLI;
    bench.now = at;
    (delay, made(&bench.input(Input::Tick)).first().copied())
}

fn unlinked_reasons(bench: &mut Bench, asks: NodeId) -> Vec<UnlinkedReason> {
    let page = bench.send(asks, &ToManager::Query { after: None });
    let [Event::Sent(_, ToNode::Page(page))] = &page[..] else {
        panic!("{page:?}");
    };
    let reason = |item: &Item| match item {
        Item::Unlinked { reason, .. } => Some(*reason),
        _ => None,
    };
    page.items.iter().filter_map(reason).collect()
}

/// The pair is linked again, after delays that grow while the node is short.
//= SM2-LNK-009, SM2-WCH-004 test
#[test]
fn a_pair_is_linked_again_after_a_shortage() {
    let (mut bench, a, b, mut link) = linked();
    let mut delays = Vec::new();
    for _ in 0..9 {
        let events = bench.send(b, &unlinked(1, link, RESOURCES));
        let told = [
            Event::Sent(b, unlink(1, link, RESOURCES.0)),
            Event::Sent(a, unlink(1, link, RESOURCES.0)),
        ];
        assert_eq!(events, told);
        let ended = UnlinkedReason::Ended { code: RESOURCES };
        assert_eq!(unlinked_reasons(&mut bench, a), [ended]);
        // The answer to UNLINK says nothing new.
        assert_eq!(bench.send(a, &unlinked(1, link, RESOURCES)), []);
        assert_eq!(bench.input(Input::Tick), [], "not before the deadline");
        let (delay, next) = next_attempt(&mut bench);
        delays.push(delay);
        link = next.expect("a link");
    }
    assert_eq!(delays, [10, 20, 40, 80, 160, 320, 640, 1_000, 1_000]);
    assert_eq!(bench.manager.links(), 1);
    assert_eq!(unlinked_reasons(&mut bench, a), []);
    assert_eq!(bench.manager.deadline(), None);
}

/// The side that has a descriptor sees the end of the stream, and may be first.
//= SM2-LNK-009 test
#[test]
fn the_side_that_is_short_may_be_the_second_one() {
    let (mut bench, a, b, link) = linked();
    let gone = Farewell::PeerGone.code();
    bench.send(a, &unlinked(1, link, gone));
    assert_eq!(bench.manager.deadline(), None, "no reason to try again");
    assert_eq!(bench.send(b, &unlinked(1, link, RESOURCES)), []);
    let (delay, next) = next_attempt(&mut bench);
    assert_eq!((delay, next.is_some()), (10, true));
    // The answer of the first code is not a reason.
    let link = next.expect("a link");
    bench.send(a, &unlinked(1, link, gone));
    bench.send(b, &unlinked(1, link, gone));
    assert_eq!(bench.manager.deadline(), None);
    let ended = UnlinkedReason::Ended { code: gone };
    assert_eq!(unlinked_reasons(&mut bench, a), [ended]);
}

/// A late answer to a link of the pair says nothing of the next one.
//= SM2-LNK-009 test
#[test]
fn a_late_answer_is_no_second_reason() {
    let (mut bench, a, b, first) = linked();
    bench.send(b, &unlinked(1, first, RESOURCES));
    let (_, second) = next_attempt(&mut bench);
    let second = second.expect("a link");
    bench.send(b, &unlinked(1, second, Code(71)));
    assert_eq!(bench.send(a, &unlinked(1, first, RESOURCES)), []);
    assert_eq!(bench.manager.deadline(), None, "a violation ended the pair");
}

//= SM2-LNK-009, SM2-IFC-003 test
#[test]
fn a_pair_that_is_gone_is_not_linked_again() {
    for withdraws_first in [false, true] {
        let (mut bench, a, b, link) = linked();
        if withdraws_first {
            bench.withdraw(a, 1);
        }
        let events = bench.send(b, &unlinked(1, link, RESOURCES));
        assert!(bench.is_known(b), "{events:?}");
        if !withdraws_first {
            bench.withdraw(a, 1);
        }
        assert_eq!(bench.manager.deadline(), None);
    }
}

/// A session that resumes is linked after CLAIMED, also where its adopted link ended before.
//= SM2-LNK-009, SM2-RES-007 test
#[test]
fn a_resuming_pair_is_linked_again_after_its_claims() {
    const OLD: LinkId = LinkId {
        epoch: 7,
        serial: 3,
    };
    for short_is_second in [false, true] {
        let mut bench = Bench::new(UNLIMITED);
        let back = |bench: &mut Bench, text: &str, contract: Contract| {
            let node = bench.connect(1);
            bench.send(node, &support::bench::resuming(text));
            bench.declared(node, 1, &contract);
            bench.send(node, &support::bench::claim(1, OLD, 9));
            node
        };
        let a = back(&mut bench, "a", scan());
        let b = back(&mut bench, "b", subscriber("scan", None));
        if short_is_second {
            bench.send(a, &unlinked(1, OLD, Farewell::PeerGone.code()));
        }
        let events = bench.send(b, &unlinked(1, OLD, RESOURCES));
        assert_eq!(made(&events), [], "not before CLAIMED");
        assert_eq!(bench.manager.deadline(), greeting(&bench));
        bench.send(a, &ToManager::Claimed);
        let events = bench.send(b, &ToManager::Claimed);
        let links = made(&events);
        assert_eq!(links.len(), 1, "{events:?}");
        assert_eq!(seen_by(&events, a).len(), 1);
    }
}

/// The deadline of the sessions that have not sent CLAIMED.
fn greeting(bench: &Bench) -> Option<sm2_proto::Instant> {
    Some(bench.now.after(UNLIMITED.time(Limit::Greeting)))
}
