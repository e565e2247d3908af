//! The counters of a node, as another node reads them.

use crate::common;

use std::thread;
use std::time::Duration;

use common::{Domain, SOON, away, back, in_slot, meet, next, until};
use nix::libc::ENOMEM;
use sm2_io::fault::{Call, Fault, Injector};
use sm2_node::Node;
use sm2_node::diagnostics::CounterView;
use sm2_proto::counters::Entry;

/// The counters of a node, as another node maps them.
fn view_of(node: &Node, tool: &Node) -> CounterView {
    let mut view = None;
    until(|| {
        view = tool.inspect(node.id().unwrap()).unwrap();
        view.is_some()
    });
    view.unwrap()
}

/// The entries of a node's counters, read by another node.
fn counters_of(node: &Node, tool: &Node) -> Vec<Entry> {
    let view = view_of(node, tool);
    view.entries().map(|(_, entry)| entry.unwrap()).collect()
}

//= SM2-CNT-003, SM2-CNT-005 test
#[test]
fn counters_of_a_node_can_be_looked_at_and_survive_its_manager() {
    let mut domain = Domain::new();
    let (talker, listener) = (domain.node("talker"), domain.node("listener"));
    let tool = domain.node("tool");
    assert!(
        tool.inspect(talker.id().unwrap()).unwrap().is_none(),
        "nothing is declared"
    );
    let publisher = talker.publisher::<[u8]>("topic").unwrap();
    let subscriber = listener.subscriber::<[u8]>("topic").unwrap();
    meet(&publisher, &[&subscriber]);
    for len in 1..=40_usize {
        publisher.publish(&vec![0; len * 200]).unwrap();
        assert_eq!(next(&subscriber).len(), len * 200);
    }
    // The last message is released when both nodes have been called.
    until(|| publisher.counters().in_flight == 0 || subscriber.links().is_empty());
    for round in 0..2 {
        let (sent, taken) = (counters_of(&talker, &tool), counters_of(&listener, &tool));
        assert_eq!((sent.len(), taken.len()), (2, 2), "{sent:?} {taken:?}");
        let link = publisher.links()[0].id;
        for entry in sent.iter().chain(&taken) {
            assert_eq!(entry.messages, 40 + round);
            assert_eq!(entry.bytes, 200 * (40 * 41 / 2) + round);
            assert!(entry.link.is_none_or(|it| it == link));
            assert!(entry.last.0 > 0 && entry.lost == 0);
        }
        assert_eq!(sent[1].fates, publisher.counters());
        assert_eq!(sent[1].recent().len(), 32);
        assert!(
            taken
                .iter()
                .all(|it| it.delay_max_ns > 0 && it.delay_sum_ns >= it.delay_max_ns)
        );
        assert_eq!(subscriber.links()[0].received.bytes, taken[1].bytes);
        if round == 0 {
            domain.stop();
            away(&[&talker, &listener, &tool]);
            domain.start();
            back(&[&talker, &listener, &tool]);
            publisher.publish(b"x").unwrap();
            assert_eq!(next(&subscriber).len(), 1);
            until(|| publisher.counters().in_flight == 0 || subscriber.links().is_empty());
        }
    }
    drop(subscriber);
    until(|| publisher.links()[0].end.is_some());
    let view = tool.inspect(talker.id().unwrap()).unwrap().unwrap();
    assert_eq!(view.entries().count(), 1, "the link's entry is free again");
    drop(publisher);
    assert_eq!(view.entries().count(), 0);
    assert!(
        tool.inspect(sm2_node::domain::NodeId(999))
            .unwrap()
            .is_none()
    );
}

/// Tools that see the counters know since when the kernel has had no memory for a link.
//= SM2-CNT-005, SM2-TRN-013 test
#[test]
fn counters_say_since_when_memory_is_short() {
    let domain = Domain::new();
    let node = |name| {
        let builder = domain.builder(name).ring_lane(false).background(false);
        builder.connect().unwrap()
    };
    let (talker, listener, tool) = (node("talker"), node("listener"), node("tool"));
    let publisher = talker.publisher::<[u8]>("topic").unwrap();
    let subscriber = listener.subscriber::<[u8]>("topic").unwrap();
    meet(&publisher, &[&subscriber]);
    let view = view_of(&talker, &tool);
    // The second entry is that of the link. A look at it does not drive the node.
    let shown = || view.entries().nth(1).unwrap().1.unwrap().short_since;
    assert_eq!(shown(), None);
    let faults = Injector::counting();
    let installed = faults.install();
    for _ in 0..2 {
        faults.set([Fault {
            call: Call::SendMsg,
            nth: 1,
            times: u64::MAX,
            errno: ENOMEM,
        }]);
        let before = sm2_node::now();
        publisher.publish(b"held").unwrap();
        faults.set(None);
        let since = shown().expect("memory is short");
        assert!((before..=sm2_node::now()).contains(&since));
        // Drives the node, which sends the message now.
        publisher.links();
        assert_eq!(shown(), None);
        assert_eq!(*next(&subscriber), *b"held");
    }
    drop(installed);
}

/// Tools that see the counters know how often a publisher was late.
//= SM2-CNT-005, SM2-QOS-009 test
#[test]
fn counters_say_how_many_deadlines_were_missed() {
    let domain = Domain::new();
    let node = |name| domain.builder(name).background(false).connect().unwrap();
    let (talker, listener, tool) = (node("talker"), node("listener"), node("tool"));
    let period = Duration::from_millis(1);
    let publisher = talker.publisher_builder::<[u8]>("topic").deadline(period);
    let publisher = publisher.declare().unwrap();
    let builder = listener.subscriber_builder::<[u8]>("topic");
    let subscriber = builder.deadline(period).declare().unwrap();
    meet(&publisher, &[&subscriber]);
    let view = view_of(&listener, &tool);
    for least in [1, 3] {
        let mut missed = 0;
        until(|| {
            // Drives the node. A look at its counters does not.
            missed = subscriber.links()[0].missed_deadlines;
            missed >= least
        });
        let entry = view.entries().nth(1).unwrap().1.unwrap();
        assert_eq!(entry.missed_deadlines, missed);
    }
}

//= SM2-CNT-005, SM2-MSG-005 test
#[test]
fn counters_say_how_many_samples_an_application_holds() {
    let domain = Domain::new();
    let (talker, listener) = (domain.node("talker"), domain.node("listener"));
    let publisher = talker.publisher::<[u8]>("topic").unwrap();
    let builder = listener.subscriber_builder::<[u8]>("topic");
    let subscriber = builder.max_borrowed(3).declare().unwrap();
    meet(&publisher, &[&subscriber]);
    let shown = || {
        let entries = counters_of(&listener, &talker);
        let [interface, end] = &entries[..] else {
            panic!("{entries:?}");
        };
        assert_eq!((interface.held, interface.max_held), (0, 0));
        assert!(interface.created.0 > 0 && interface.created <= end.created);
        assert_eq!(end.max_held, 3);
        (end.messages, end.held)
    };
    assert_eq!(shown(), (0, 0));
    let mut held = Vec::new();
    for message in 1..=3 {
        publisher.publish(&in_slot(&[1])).unwrap();
        held.push(next(&subscriber));
        assert_eq!(shown(), (message, message));
    }
    held.remove(1);
    assert_eq!(shown(), (3, 2));
    drop(held);
    assert_eq!(shown(), (3, 0));
}

#[test]
fn counters_of_a_service_count_calls() {
    let domain = Domain::new();
    let (serving, calling) = (domain.node("server"), domain.node("client"));
    let server = serving.server::<u8, u8>("add").unwrap();
    let client = calling.client::<u8, u8>("add").unwrap();
    thread::scope(|scope| {
        scope.spawn(|| {
            for _ in 0..5 {
                let request = server.recv_timeout(SOON).unwrap().unwrap();
                let sum = *request + 1;
                request.reply(&sum).unwrap();
            }
        });
        client.wait_for_servers_timeout(1, SOON).unwrap();
        for number in 0..5 {
            assert_eq!(*client.call_timeout(&number, SOON).unwrap(), number + 1);
        }
    });
    for node in [&serving, &calling] {
        let view = calling.inspect(node.id().unwrap()).unwrap().unwrap();
        for (_, entry) in view.entries() {
            assert_eq!(entry.unwrap().messages, 5);
        }
    }
    assert_eq!(client.links()[0].received.messages, 5);
}
