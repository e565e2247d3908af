//! The lifespan of messages: with and without the background thread, on both lanes, in all forms of payload.

use std::thread;
use std::time::Duration;

use crate::common::fixture::Fixture;
use crate::common::{Domain, SOON, meet, until};
use sm2_node::{Node, Publisher};

/// Long enough that a busy machine does not miss it.
const HOUR: Duration = Duration::from_secs(3_600);
const SHORT: Duration = Duration::from_millis(2);

/// A publisher for each form: inline, pooled, sealed.
fn publishers(node: &Node, lifespan: Duration) -> [Publisher<[u8]>; 3] {
    [0, 1, 2].map(|form| {
        let builder = node.publisher_builder(&format!("topic{form}"));
        let builder = builder.inline_max(if form == 0 { 4_096 } else { 0 });
        let builder = builder.sealed(form == 2).lifespan(lifespan);
        builder.declare().unwrap()
    })
}

//= SM2-QOS-010, SM2-QOS-006 test
#[test]
fn messages_that_are_too_old_are_not_handed_out() {
    Fixture::each(|it| {
        let (talker, listener) = (it.node("talker"), it.node("listener"));
        for (form, publisher) in publishers(&talker, SHORT).iter().enumerate() {
            let subscriber = listener.subscriber::<[u8]>(&format!("topic{form}"));
            let subscriber = subscriber.unwrap();
            meet(publisher, &[&subscriber]);
            for _ in 0..3 {
                publisher.publish(b"old").unwrap();
            }
            thread::sleep(2 * SHORT);
            assert!(subscriber.try_recv().unwrap().is_none(), "form {form}");
            until(|| publisher.counters().in_flight == 0);
            let counters = publisher.counters();
            assert_eq!((counters.offered, counters.expired), (3, 3), "form {form}");
            assert_eq!(subscriber.links()[0].received.expired, 3, "form {form}");
            assert_eq!(subscriber.links()[0].received.messages, 0, "form {form}");
        }
    });
}

//= SM2-QOS-010 test
#[test]
fn messages_in_time_are_handed_out() {
    Fixture::each(|it| {
        let (talker, listener) = (it.peer("talker"), it.node("listener"));
        for (form, publisher) in publishers(&talker, HOUR).iter().enumerate() {
            let subscriber = listener.subscriber::<[u8]>(&format!("topic{form}"));
            let subscriber = subscriber.unwrap();
            subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
            publisher.publish(b"new").unwrap();
            let sample = subscriber.recv_timeout(SOON).unwrap().expect("a message");
            assert_eq!(&*sample, b"new");
            assert_eq!(subscriber.links()[0].received.expired, 0);
        }
    });
}

//= SM2-QOS-010, SM2-QOS-005 test
#[test]
fn latched_messages_expire_as_well() {
    Fixture::each(|it| {
        let (talker, listener) = (it.node("talker"), it.peer("listener"));
        let builder = talker.publisher_builder::<[u8]>("map").latched(2);
        let publisher = builder.lifespan(SHORT).declare().unwrap();
        for _ in 0..3 {
            publisher.publish(b"old").unwrap();
        }
        thread::sleep(2 * SHORT);
        let subscriber = listener.subscriber::<[u8]>("map").unwrap();
        publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
        until(|| publisher.counters().expired == 2);
        assert_eq!(publisher.counters().offered, 2);
        assert!(subscriber.try_recv().unwrap().is_none());
    });
}

/// Messages that wait for a subscriber that takes none leave the queue of the publisher, which has room again.
//= SM2-QOS-010, SM2-QOS-006 test
#[test]
fn the_accounts_are_exact_while_messages_expire() {
    Fixture::each(|it| {
        let (talker, listener) = (it.node("talker"), it.node("listener"));
        let builder = talker.publisher_builder::<[u8]>("topic").reliable(true);
        let builder = builder.depth(2).publish_timeout(Duration::ZERO);
        let publisher = builder.lifespan(SHORT).declare().unwrap();
        let builder = listener.subscriber_builder::<[u8]>("topic");
        let builder = builder.depth(1).max_borrowed(1).reliable(true);
        let subscriber = builder.declare().unwrap();
        meet(&publisher, &[&subscriber]);
        let check = || {
            let it = publisher.counters();
            assert_eq!(it.offered, it.delivered + it.dropped() + it.in_flight);
            it
        };
        for _ in 0..10 {
            publisher.publish(b"old").unwrap();
            check();
        }
        thread::sleep(2 * SHORT);
        until(|| {
            while subscriber.try_recv().unwrap().is_some() {}
            check().in_flight == 0
        });
        let it = check();
        assert_eq!(it.offered, 10);
        assert!(it.expired > 0, "{it:?}");
    });
}

/// On the socket lane, where a publisher has a queue: in a ring, the subscriber finds what is too old.
//= SM2-QOS-010 test
#[test]
fn what_is_too_old_leaves_the_queue_although_the_subscriber_takes_nothing() {
    for background in [true, false] {
        let domain = Domain::new();
        let node = |name| domain.builder(name).ring_lane(false).background(background);
        let talker = node("talker").connect().unwrap();
        let builder = talker.publisher_builder::<[u8]>("topic").reliable(true);
        // Longer than it takes to fill the queue.
        let builder = builder.depth(2).lifespan(Duration::from_millis(100));
        let publisher = builder.declare().unwrap();
        let listener = node("listener").connect().unwrap();
        let builder = listener.subscriber_builder::<[u8]>("topic").reliable(true);
        let subscriber = builder.depth(1).max_borrowed(1).declare().unwrap();
        meet(&publisher, &[&subscriber]);
        until(|| publisher.try_publish(b"old").unwrap().is_none());
        until(|| publisher.try_publish(b"new").unwrap().is_some());
        let counters = publisher.counters();
        assert!(counters.expired > 0, "{counters:?}");
        assert_eq!((counters.delivered, counters.no_room), (0, 0));
    }
}
