//! How long a publisher waits for reliable subscribers that take their messages slowly, or not at all. The publisher
//! counts how long it has waited.

// Shows DAT-LOCAL, DAT-WAIT (test), bound: one process.

use std::time::{Duration, Instant};

use crate::common::fixture::Fixture;
use crate::common::{Endpoint, meet, next};
use sm2_node::{Node, Publisher, PublisherBuilder, Sample, Subscriber};

const MOMENT: Duration = Duration::from_millis(1);
/// A message in a slot, which takes room until it is released.
const MESSAGE: [u8; 128] = [b'x'; 128];

fn builder(node: &Node) -> PublisherBuilder<[u8]> {
    node.publisher_builder::<[u8]>("topic").reliable(true)
}

/// A reliable subscriber whose program can hold all messages of its window.
fn holder(node: &Node) -> Subscriber<[u8]> {
    let builder = node.subscriber_builder::<[u8]>("topic").reliable(true);
    builder.depth(4).max_borrowed(4).declare().unwrap()
}

/// Publishes until a reliable subscriber has no room and the publication would wait.
fn fill(publisher: &Publisher<[u8]>) -> usize {
    (0..1_000)
        .take_while(|_| publisher.try_publish(&MESSAGE).unwrap().is_some())
        .count()
}

/// Takes all messages that the subscriber may hold, and keeps them.
fn take(subscriber: &Subscriber<[u8]>, samples: &mut Vec<Sample<[u8]>>) {
    while samples.len() < 4 {
        match subscriber.recv_timeout(Duration::ZERO).unwrap() {
            Some(sample) => samples.push(sample),
            None => return,
        }
    }
}

/// Subscribers that release one message after each fourth publication made each of the next publications wait. A
/// healthy subscriber beside them got a third of the messages that a publisher sends at 200 Hz.
//= SM2-QOS-003 test
#[test]
fn subscribers_that_release_now_and_then_are_waited_for_once() {
    for count in [1, 10] {
        Fixture::each(|it| {
            let (talker, listener) = (it.node("talker"), it.node("listener"));
            // All with the defaults.
            let publisher = builder(&talker).declare().unwrap();
            let healthy = it.node("healthy").subscriber::<[u8]>("topic").unwrap();
            let hostile: Vec<_> = (0..count).map(|_| holder(&listener)).collect();
            let mut all: Vec<&dyn Endpoint> = vec![&healthy];
            all.extend(hostile.iter().map(|it| it as &dyn Endpoint));
            meet(&publisher, &all);
            let mut samples: Vec<_> = hostile.iter().map(|_| Vec::new()).collect();
            let begin = Instant::now();
            let messages = 400;
            for number in 1..=messages {
                publisher.publish(&MESSAGE).unwrap();
                let sample = next(&healthy);
                assert_eq!((sample.sequence(), sample.lost()), (number, 0));
                for (subscriber, samples) in hostile.iter().zip(&mut samples) {
                    take(subscriber, samples);
                    if number % 4 == 0 && !samples.is_empty() {
                        samples.remove(0);
                    }
                }
            }
            // One timeout, and the share of the time that the test took.
            let waited = publisher.waited();
            let timeout = Duration::from_millis(100);
            let most = timeout + begin.elapsed() / 100;
            assert!(waited >= timeout && waited <= most, "{waited:?}, {most:?}");
            let links = publisher.links();
            for link in links.iter().filter(|link| link.reliable) {
                let it = link.counters;
                assert_eq!(it.offered, messages);
                assert_eq!(it.offered, it.delivered + it.no_room + it.in_flight);
                assert!(it.delivered > 50 && it.no_room > 100, "{it:?}");
            }
            // Their programs learn of each gap.
            for (subscriber, mut samples) in hostile.iter().zip(samples) {
                samples.clear();
                take(subscriber, &mut samples);
                assert!(subscriber.lost() > 0);
            }
        });
    }
}

/// A link that owes gets what it has room for, and no publication waits for it until all that it had has come back.
//= SM2-QOS-003 test
#[test]
fn a_link_that_owes_is_not_waited_for_until_it_has_caught_up() {
    Fixture::each(|it| {
        let (talker, listener) = (it.node("talker"), it.node("listener"));
        let publisher = builder(&talker).publish_timeout(MOMENT).declare().unwrap();
        let slow = holder(&listener);
        meet(&publisher, &[&slow]);
        let room = fill(&publisher);
        assert_eq!(publisher.publish(&MESSAGE).unwrap().missed, 1);
        // One comes back, so there is room for one more. Then a publication waited again.
        drop(next(&slow));
        let published = publisher.try_publish(&MESSAGE).unwrap().unwrap();
        assert_eq!((published.links, published.missed), (1, 0));
        let published = publisher.try_publish(&MESSAGE).unwrap().expect("no wait");
        assert_eq!((published.links, published.missed), (0, 1));
        assert_eq!(publisher.waited(), MOMENT);
        // All come back.
        for _ in 0..room {
            drop(next(&slow));
            publisher.counters();
        }
        assert_eq!(fill(&publisher), room);
        assert_eq!(slow.lost(), 1);
        drop(next(&slow));
        assert_eq!(publisher.counters().no_room, 2);
    });
}

/// The waits for all links come from one budget: once it is used up, a link that does not owe misses a message, too.
//= SM2-QOS-004 test
#[test]
fn all_links_share_the_time_that_a_publisher_waits() {
    Fixture::each(|it| {
        for (share_percent, waits) in [(0, 1), (100, 3)] {
            let (talker, listener) = (it.node("talker"), it.node("listener"));
            let builder = builder(&talker).wait_share_percent(share_percent);
            let publisher = builder.publish_timeout(MOMENT).declare().unwrap();
            let slow = holder(&listener);
            meet(&publisher, &[&slow]);
            for _ in 0..3 {
                let room = fill(&publisher);
                assert_eq!(publisher.publish(&MESSAGE).unwrap().missed, 1);
                for _ in 0..room {
                    drop(next(&slow));
                    publisher.counters();
                }
            }
            assert_eq!(publisher.waited(), MOMENT * waits);
            assert_eq!(publisher.counters().no_room, 3);
        }
    });
}
