//! Publications that are bounded in time, or that wait for no one: with and without the background thread, on both
//! lanes.

use crate::common;
use std::thread;
use std::time::Duration;

use crate::common::fixture::Fixture;
use crate::common::threads::while_asleep;
use crate::common::wait::{LONG, is_quiet};
use crate::common::{SOON, meet, next, pattern};
use sm2_node::{Node, Published, Publisher, Subscriber, WaitError, WaitSet};

/// A publisher that waits for as long as it takes.
fn publisher(node: &Node) -> Publisher<[u8]> {
    let builder = node.publisher_builder::<[u8]>("topic").reliable(true);
    builder.publish_timeout(LONG).declare().unwrap()
}

/// A reliable subscriber with a window of two messages.
fn narrow(node: &Node) -> Subscriber<[u8]> {
    let builder = node.subscriber_builder::<[u8]>("topic").reliable(true);
    builder.depth(1).max_borrowed(1).declare().unwrap()
}

/// Publishes until a reliable subscriber has no room. Returns how many messages were published.
fn fill(publisher: &Publisher<[u8]>, bytes: &[u8]) -> u64 {
    let mut count = 0;
    while let Some(published) = publisher.try_publish(bytes).unwrap() {
        assert_eq!(published.missed, 0);
        count += 1;
        assert!(count < 1_000, "there is always room");
    }
    count
}

/// Messages in cells of the ring, those in slots, and long ones take different ways.
const LENGTHS: [usize; 3] = [20, 200, 200_000];
/// A message in a cell and one in a slot.
const MESSAGES: [&[u8]; 2] = [b"x", &[b'x'; 200]];

#[test]
fn all_subscribers_get_a_message_or_none() {
    Fixture::each(|it| {
        for len in LENGTHS {
            let (talker, listener) = (it.node("talker"), it.node("listener"));
            let publisher = publisher(&talker);
            let slow = narrow(&listener);
            let careful = listener.subscriber_builder::<[u8]>("topic").reliable(true);
            let careful = careful.depth(100).declare().unwrap();
            let quick = listener.subscriber_builder::<[u8]>("topic").depth(100);
            let quick = quick.declare().unwrap();
            meet(&publisher, &[&slow, &careful, &quick]);
            let bytes = pattern(len, 1);
            let published = fill(&publisher, &bytes);
            let all = publisher.links();
            assert!(all.iter().all(|link| link.counters.offered == published));
            for subscriber in [&careful, &quick] {
                for _ in 0..published {
                    assert!(*next(subscriber) == *bytes);
                }
                assert!(subscriber.try_recv().unwrap().is_none());
            }
            assert!(*next(&slow) == *bytes);
            assert!(publisher.wait_for_room_timeout(SOON).unwrap());
            let published = publisher.try_publish(&bytes).unwrap().expect("room");
            assert_eq!((published.links, published.missed), (3, 0));
            assert_eq!(publisher.counters().dropped(), 0);
        }
    });
}

#[test]
fn a_wait_for_room_ends_when_there_is_some() {
    Fixture::each(|it| {
        for message in MESSAGES {
            let (talker, listener) = (it.node("talker"), it.peer("listener"));
            let publisher = publisher(&talker);
            publisher.wait_for_room().unwrap();
            let slow = narrow(&listener);
            meet(&publisher, &[&slow]);
            fill(&publisher, message);
            let moment = Duration::from_millis(1);
            assert!(!publisher.wait_for_room_timeout(moment).unwrap());
            while_asleep(|| publisher.wait_for_room().unwrap(), |_| drop(next(&slow)));
            assert!(publisher.try_publish(message).unwrap().is_some());
            // A subscriber that leaves is not waited for.
            while_asleep(|| publisher.wait_for_room().unwrap(), |_| drop(slow));
        }
    });
}

#[test]
fn a_wait_for_room_ends_with_a_shutdown() {
    Fixture::each(|it| {
        let (talker, listener) = (it.ending_node("talker"), it.peer("listener"));
        let publisher = publisher(&talker);
        let slow = narrow(&listener);
        meet(&publisher, &[&slow]);
        fill(&publisher, b"x");
        let waited = while_asleep(|| publisher.wait_for_room(), |_| it.shutdown.request());
        assert!(matches!(waited, Err(WaitError::Shutdown)), "{waited:?}");
    });
}

/// A subscriber that has no room until the timeout misses the message. From then on nothing waits for it, until it has
/// released all that it had.
//= SM2-QOS-002, SM2-QOS-003 test
#[test]
fn a_publication_has_its_own_timeout() {
    Fixture::each(|it| {
        for (as_loan, message) in [
            (false, MESSAGES[0]),
            (false, MESSAGES[1]),
            (true, MESSAGES[1]),
        ] {
            let (talker, listener) = (it.node("talker"), it.node("listener"));
            let publisher = publisher(&talker);
            let slow = narrow(&listener);
            let builder = listener.subscriber_builder::<[u8]>("topic").reliable(true);
            let prompt = builder.depth(100).declare().unwrap();
            meet(&publisher, &[&slow, &prompt]);
            let mut taken = 0;
            let mut take_all = || {
                while let Some(sample) = prompt.recv_timeout(Duration::ZERO).unwrap() {
                    assert_eq!(&*sample, message);
                    taken += 1;
                }
                taken
            };
            let published = fill(&publisher, message) as usize;
            assert_eq!(take_all(), published);
            let moment = Duration::from_millis(1);
            let result = if as_loan {
                let mut loan = publisher.loan_slice(message.len()).unwrap();
                loan.copy_from_slice(message);
                loan.publish_timeout(moment).unwrap()
            } else {
                publisher.publish_timeout(message, moment).unwrap()
            };
            let missed_by_one = Published {
                links: 1,
                missed: 1,
                too_long: 0,
            };
            assert_eq!(result, missed_by_one);
            assert_eq!(take_all(), published + 1);
            // These would wait for an hour.
            publisher.wait_for_room().unwrap();
            assert_eq!(publisher.publish(message).unwrap(), missed_by_one);
            assert_eq!(take_all(), published + 2);
            assert_eq!(publisher.try_publish(message).unwrap(), Some(missed_by_one));
            assert_eq!(take_all(), published + 3);
            // Now it is waited for again.
            for _ in 0..published {
                drop(next(&slow));
                publisher.counters();
            }
            assert!(publisher.wait_for_room_timeout(SOON).unwrap());
            assert_eq!(fill(&publisher, message), published as u64);
            assert_eq!(take_all(), 2 * published + 3);
        }
    });
}

/// A subscriber that holds the memory has no room (SM2-QOS-007), for short messages as for long ones.
//= SM2-QOS-007 test
#[test]
fn a_subscriber_that_holds_the_memory_has_no_room() {
    Fixture::each(|it| {
        for len in &LENGTHS[1..] {
            let (talker, listener) = (it.node("talker"), it.peer("listener"));
            let builder = talker.publisher_builder::<[u8]>("topic").reliable(true);
            let limit = 20 * len.next_power_of_two().max(128) as u64;
            let builder = builder.publish_timeout(LONG).pool_limit(limit);
            // On the socket lane, a short message needs a slot only with this option.
            let publisher = builder.inline_max(0).declare().unwrap();
            let builder = listener.subscriber_builder::<[u8]>("topic").reliable(true);
            let hoard = builder.depth(500).max_borrowed(500).declare().unwrap();
            meet(&publisher, &[&hoard]);
            let bytes = pattern(*len, 1);
            let published = fill(&publisher, &bytes);
            let samples: Vec<_> = (0..published).map(|_| next(&hoard)).collect();
            assert!(publisher.try_publish(&bytes).unwrap().is_none());
            let counters = publisher.counters();
            assert_eq!((counters.offered, counters.pool_limit), (published, 0));
            // A publication waits until the samples come back, and nothing is missed.
            let result = while_asleep(|| publisher.publish(&bytes).unwrap(), |_| drop(samples));
            assert_eq!((result.links, result.missed), (1, 0));
            assert_eq!(publisher.counters().dropped(), 0);
        }
    });
}

#[test]
fn a_wait_set_reports_room() {
    Fixture::each(|it| {
        for message in MESSAGES {
            let (talker, listener) = (it.node("talker"), it.peer("listener"));
            let publisher = publisher(&talker);
            let slow = narrow(&listener);
            meet(&publisher, &[&slow]);
            let mut set = WaitSet::new().unwrap();
            set.add(&publisher, ()).unwrap();
            assert!(!is_quiet(&mut set), "there is room");
            fill(&publisher, message);
            assert!(is_quiet(&mut set));
            while_asleep(|| common::wait::next(&mut set), |_| drop(next(&slow)));
            assert!(publisher.try_publish(message).unwrap().is_some());
            assert!(is_quiet(&mut set));
        }
    });
}

#[test]
fn messages_without_a_subscriber_are_counted() {
    Fixture::each(|it| {
        let (talker, listener) = (it.node("talker"), it.node("listener"));
        let publisher = publisher(&talker);
        publisher.publish(b"x").unwrap();
        publisher.try_publish(b"x").unwrap();
        assert_eq!(publisher.unheard(), 2);
        let slow = narrow(&listener);
        meet(&publisher, &[&slow]);
        fill(&publisher, b"x");
        publisher.publish_timeout(b"x", Duration::ZERO).unwrap();
        assert_eq!(publisher.unheard(), 2);
    });
}

/// How many messages each of two threads publishes.
const EACH: u64 = 1_000;

/// A message that waits for room is not overtaken by one of another thread that finds room at that moment.
//= SM2-QOS-002 test
#[test]
fn threads_that_wait_for_room_keep_their_order() {
    Fixture::each(|it| {
        let (talker, listener) = (it.node("talker"), it.node("listener"));
        let publisher = publisher(&talker);
        let subscriber = narrow(&listener);
        meet(&publisher, &[&subscriber]);
        let publish = || {
            for number in 0..EACH {
                let message = MESSAGES[number as usize % 2];
                assert_eq!(publisher.publish(message).unwrap().missed, 0);
            }
            // Without the background thread, calls send the messages that wait in the publisher.
            publisher.flush().unwrap();
        };
        thread::scope(|scope| {
            scope.spawn(publish);
            scope.spawn(publish);
            for number in 1..=2 * EACH {
                let sample = next(&subscriber);
                assert_eq!((sample.sequence(), sample.lost()), (number, 0));
            }
        });
        assert_eq!(publisher.counters().dropped(), 0);
    });
}
