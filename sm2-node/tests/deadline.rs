//! Deadlines of publishers and subscribers: with and without the background thread, on both lanes.

use std::time::Duration;

use crate::common::fixture::Fixture;
use crate::common::periods::only_short_offers_match;
use crate::common::{Domain, LANES, SOON, meet, until};
use sm2_node::domain::Finding;
use sm2_node::{Event, Events, Node, Publisher, Subscriber, WaitSet};

/// Long enough that a busy machine does not miss it.
const HOUR: Duration = Duration::from_secs(3_600);
const SHORT: Duration = Duration::from_millis(5);

fn publisher(node: &Node, deadline: Duration) -> Publisher<u64> {
    let builder = node.publisher_builder("topic").deadline(deadline);
    builder.declare().unwrap()
}

fn subscriber(node: &Node, deadline: Duration) -> Subscriber<u64> {
    let builder = node.subscriber_builder("topic").deadline(deadline);
    builder.declare().unwrap()
}

/// Waits for the next missed deadline. Returns the name of the publisher that missed it.
fn missed(events: &Events) -> Option<String> {
    loop {
        let event = events.next_timeout(SOON).unwrap().expect("an event");
        if let Event::DeadlineMissed { peer, periods } = event {
            assert!(periods > 0);
            return peer.map(|it| it.name.to_string());
        }
    }
}

//= SM2-QOS-009 test
#[test]
fn both_sides_notice_a_publisher_that_is_silent() {
    Fixture::each(|it| {
        let (talker, listener) = (it.node("talker"), it.node("listener"));
        let publisher = publisher(&talker, SHORT);
        let subscriber = subscriber(&listener, SHORT);
        meet(&publisher, &[&subscriber]);
        let (sent, received) = (publisher.events(), subscriber.events());
        for round in 0..3 {
            // The event comes again at the end of each period, also after a message.
            assert_eq!(missed(&sent), None, "round {round}");
            let name = missed(&received);
            assert_eq!(name.as_deref(), Some("talker"), "round {round}");
            publisher.publish(&round).unwrap();
            until(|| subscriber.try_recv().unwrap().is_some());
        }
        assert!(publisher.missed_deadlines() >= 3);
        let [link] = &subscriber.links()[..] else {
            panic!("one link");
        };
        assert!(link.missed_deadlines >= 3);
        assert!(subscriber.missed_deadlines() >= link.missed_deadlines);
        assert_eq!(
            publisher.links()[0].missed_deadlines,
            0,
            "it counts its own"
        );
        // The count of a link outlives it.
        let before = subscriber.missed_deadlines();
        drop(publisher);
        until(|| subscriber.links()[0].end.is_some());
        assert!(subscriber.missed_deadlines() >= before);
    });
}

//= SM2-QOS-009 test
#[test]
fn messages_in_time_are_no_event() {
    Fixture::each(|it| {
        let (talker, listener) = (it.node("talker"), it.node("listener"));
        let publisher = publisher(&talker, HOUR);
        let subscriber = subscriber(&listener, HOUR);
        meet(&publisher, &[&subscriber]);
        publisher.publish(&1).unwrap();
        assert_eq!(publisher.missed_deadlines(), 0);
        assert_eq!(subscriber.missed_deadlines(), 0);
    });
}

/// Only the background thread is there to notice it.
//= SM2-QOS-009 test
#[test]
fn a_sleeping_program_misses_no_missed_deadline() {
    Fixture::each(|it| {
        let (talker, listener) = (it.peer("talker"), it.peer("listener"));
        let publisher = publisher(&talker, SHORT);
        let subscriber = subscriber(&listener, SHORT);
        meet(&publisher, &[&subscriber]);
        let shows = |of: &dyn Fn() -> u64| until(|| of() > 0);
        shows(&|| publisher.missed_deadlines());
        shows(&|| subscriber.missed_deadlines());
    });
}

/// On the socket lane, messages wait in the socket of a program that sleeps. The tick reads them, so that it sees
/// those that came in time, and so they displace each other.
//= SM2-QOS-009 test
#[test]
fn a_tick_reads_the_messages_of_a_sleeping_program() {
    Fixture::each(|it| {
        let (talker, listener) = (it.peer("talker"), it.peer("listener"));
        let publisher = publisher(&talker, SHORT);
        let subscriber = subscriber(&listener, SHORT);
        meet(&publisher, &[&subscriber]);
        until(|| {
            publisher.publish(&1).unwrap();
            publisher.counters().discarded > 0
        });
    });
}

/// The tick reads the DOORBELL of a message before the program does that sleeps until this message comes.
//= SM2-QOS-009, SM2-RNG-012 test
#[test]
fn a_tick_that_reads_a_message_wakes_the_program() {
    for ring in LANES {
        let domain = Domain::new();
        let talker = domain.node_on(ring, "talker");
        let listener = domain.builder("listener").ring_lane(ring);
        let listener = listener.background(false).connect().unwrap();
        let publisher = publisher(&talker, SHORT);
        let subscriber = subscriber(&listener, SHORT);
        let other = listener.publisher::<u64>("other").unwrap();
        meet(&publisher, &[&subscriber]);
        let mut set = WaitSet::new().unwrap();
        set.add(&subscriber, ()).unwrap();
        // The set has looked at the subscriber, so the next message comes with a DOORBELL.
        assert_eq!(set.wait_timeout(SHORT).unwrap().map(|it| it.tag), None);
        publisher.publish(&7).unwrap();
        // Only a call for another interface drives the control side after the end of the period: it ticks.
        std::thread::sleep(2 * SHORT);
        other.publish(&1).unwrap();
        let ready = set.wait_timeout(SOON).unwrap();
        assert!(ready.is_some(), "the set sleeps: ring lane {ring}");
        assert_eq!(*subscriber.try_recv().unwrap().unwrap(), 7);
    }
}

//= SM2-QOS-009, SM2-MAT-001 test
#[test]
fn only_a_deadline_that_is_short_enough_matches() {
    Fixture::each(|it| {
        only_short_offers_match(it, publisher, subscriber, |offered, demanded| {
            Finding::Deadline { offered, demanded }
        });
    });
}
