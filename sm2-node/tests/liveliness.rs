//! Liveliness of publishers: with and without the background thread, on both lanes.

use std::time::{Duration, Instant};

use crate::common::fixture::Fixture;
use crate::common::periods::only_short_offers_match;
use crate::common::{SOON, meet, until};
use sm2_node::domain::Finding;
use sm2_node::{Event, Events, Node, Publisher, Subscriber};

/// Long enough that a busy machine does not miss it.
const HOUR: Duration = Duration::from_secs(3_600);
const SHORT: Duration = Duration::from_millis(20);

fn publisher(node: &Node, lease: Duration) -> Publisher<u64> {
    let builder = node.publisher_builder("topic").liveliness(lease);
    builder.declare().unwrap()
}

fn subscriber(node: &Node, lease: Duration) -> Subscriber<u64> {
    let builder = node.subscriber_builder("topic").liveliness(lease);
    builder.declare().unwrap()
}

/// Waits until the publisher is alive, or not alive, and calls `act` from time to time. Returns the name of its node.
fn change(events: &Events, to_alive: bool, act: impl Fn()) -> Option<String> {
    let deadline = Instant::now() + SOON;
    while Instant::now() < deadline {
        act();
        let event = events.next_timeout(Duration::from_millis(5)).unwrap();
        let (is_alive, peer) = match event {
            Some(Event::LivelinessLost { peer }) => (false, peer),
            Some(Event::LivelinessRegained { peer }) => (true, peer),
            _ => continue,
        };
        if is_alive == to_alive {
            return peer.map(|it| it.name.to_string());
        }
    }
    panic!("waited in vain")
}

//= SM2-QOS-011, SM2-QOS-012 test
#[test]
fn both_sides_notice_a_program_that_stops_and_goes_on() {
    Fixture::each(|it| {
        let (talker, listener) = (it.node("talker"), it.node("listener"));
        let publisher = publisher(&talker, SHORT);
        let subscriber = subscriber(&listener, SHORT);
        meet(&publisher, &[&subscriber]);
        // Nobody is alive when the events are collected from here on.
        until(|| publisher.lost_liveliness() > 0 && subscriber.lost_liveliness() > 0);
        let (own, of_peer) = (publisher.events(), subscriber.events());
        for round in 0..4 {
            // On a busy machine, a sign of life may come too late.
            let show_life = || match round % 2 {
                0 => publisher.assert_liveliness(),
                _ => drop(publisher.publish(&round).unwrap()),
            };
            assert_eq!(change(&own, true, show_life), None);
            let name = change(&of_peer, true, show_life);
            assert_eq!(name.as_deref(), Some("talker"));
            assert_eq!(change(&own, false, || ()), None);
            let name = change(&of_peer, false, || ());
            assert_eq!(name.as_deref(), Some("talker"));
            while subscriber.try_recv().unwrap().is_some() {}
        }
        assert!(publisher.lost_liveliness() >= 5);
        let [link] = &subscriber.links()[..] else {
            panic!("one link");
        };
        assert!(link.lost_liveliness >= 5 && subscriber.lost_liveliness() >= link.lost_liveliness);
        assert!(
            publisher.links()[0].alive,
            "a publisher watches itself alone"
        );
        // The count of a link outlives it.
        let before = subscriber.lost_liveliness();
        drop(publisher);
        until(|| subscriber.links()[0].end.is_some());
        assert!(subscriber.lost_liveliness() >= before);
    });
}

//= SM2-QOS-011 test
#[test]
fn a_program_that_shows_itself_in_time_is_alive() {
    Fixture::each(|it| {
        let (talker, listener) = (it.node("talker"), it.node("listener"));
        let publisher = publisher(&talker, HOUR);
        let subscriber = subscriber(&listener, HOUR);
        meet(&publisher, &[&subscriber]);
        publisher.publish(&1).unwrap();
        publisher.assert_liveliness();
        assert!(subscriber.links()[0].alive);
        assert_eq!(
            (publisher.lost_liveliness(), subscriber.lost_liveliness()),
            (0, 0)
        );
    });
}

/// Only the background thread is there to notice it.
//= SM2-QOS-011 test
#[test]
fn a_sleeping_program_misses_no_loss_of_liveliness() {
    Fixture::each(|it| {
        let (talker, listener) = (it.peer("talker"), it.peer("listener"));
        let publisher = publisher(&talker, SHORT);
        let subscriber = subscriber(&listener, SHORT);
        meet(&publisher, &[&subscriber]);
        until(|| publisher.lost_liveliness() > 0);
        until(|| subscriber.lost_liveliness() > 0 && !subscriber.links()[0].alive);
    });
}

/// The program of the subscriber reads nothing. Packets for all assertions would fill the socket, and the message would
/// find no room.
//= SM2-QOS-012 test
#[test]
fn assertions_do_not_wait_for_a_subscriber_that_reads_nothing() {
    Fixture::each(|it| {
        let (talker, listener) = (it.peer("talker"), it.peer("listener"));
        let publisher = publisher(&talker, HOUR);
        let subscriber = subscriber(&listener, HOUR);
        meet(&publisher, &[&subscriber]);
        for _ in 0..2_000 {
            publisher.assert_liveliness();
        }
        publisher.publish(&7).unwrap();
        until(|| {
            // It may wait for room, which a call makes if there is no background thread.
            let _ = publisher.counters();
            subscriber.try_recv().unwrap().is_some()
        });
        assert!(subscriber.links()[0].alive && subscriber.links()[0].open);
    });
}

//= SM2-QOS-011, SM2-MAT-001 test
#[test]
fn only_a_lease_that_is_short_enough_matches() {
    Fixture::each(|it| {
        only_short_offers_match(it, publisher, subscriber, |offered, demanded| {
            Finding::Liveliness { offered, demanded }
        });
    });
}
