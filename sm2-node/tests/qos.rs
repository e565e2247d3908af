//! Quality of service: messages that are kept, wait or are lost, and their counters.

use std::thread;
use std::time::{Duration, Instant};

use crate::common::{
    Domain, LANES, SOON, default_pair, meet, next, pair, pattern, ring_lane, until,
};
use sm2_io::fault::{Call, Injector};
use sm2_node::{Node, RecvError, Sample, Subscriber};

//= SM2-QOS-005 test
#[test]
fn late_subscribers_get_what_is_latched_first() {
    let domain = Domain::new();
    let node = domain.node("map");
    for inline_max in [61_440, 0] {
        let builder = node.publisher_builder::<[u8]>("map").latched(3);
        let publisher = builder.inline_max(inline_max).declare().unwrap();
        for seed in 1..=5 {
            assert_eq!(publisher.publish(&pattern(6000, seed)).unwrap().links, 0);
        }
        // The second subscriber needs another form than the stored one.
        for (first, sealed) in [(3, false), (4, true)] {
            let builder = domain.node("late").subscriber_builder::<[u8]>("map");
            let subscriber = builder.sealed(sealed).declare().unwrap();
            meet(&publisher, &[&subscriber]);
            let last = first + 3;
            publisher.publish(&pattern(6000, last)).unwrap();
            for seed in first..=last {
                assert!(*next(&subscriber) == *pattern(6000, seed), "{seed}");
            }
        }
    }
}

//= SM2-QOS-005 test
#[test]
fn a_reliable_subscriber_gets_all_that_is_latched_however_small_its_window() {
    let domain = Domain::new();
    let node = domain.node("map");
    let builder = node.publisher_builder::<[u8]>("map").latched(10).depth(1);
    let publisher = builder
        .reliable(true)
        .publish_timeout(Duration::ZERO)
        .declare()
        .unwrap();
    for seed in 1..=10 {
        publisher.publish(&pattern(6000, seed)).unwrap();
    }
    let builder = domain.node("late").subscriber_builder::<[u8]>("map");
    let subscriber = builder
        .depth(1)
        .max_borrowed(1)
        .reliable(true)
        .declare()
        .unwrap();
    meet(&publisher, &[&subscriber]);
    // Latched messages come first: there is no room for this message yet.
    assert_eq!(publisher.publish(&pattern(6000, 11)).unwrap().missed, 1);
    for seed in 1..=10 {
        assert!(
            *take_while_driving(&subscriber, &node) == *pattern(6000, seed),
            "{seed}"
        );
    }
    node.spin_some().unwrap();
    assert_eq!(publisher.publish(&pattern(6000, 12)).unwrap().missed, 0);
    let sample = next(&subscriber);
    assert_eq!((sample.sequence(), sample.lost()), (12, 1));
}

/// Receives while it drives another node of this thread.
fn take_while_driving(subscriber: &Subscriber<[u8]>, node: &Node) -> Sample<[u8]> {
    let deadline = Instant::now() + SOON;
    loop {
        if let Some(sample) = subscriber.recv_timeout(Duration::from_millis(1)).unwrap() {
            return sample;
        }
        node.spin_some().unwrap();
        assert!(Instant::now() < deadline, "no message");
    }
}

//= SM2-QOS-001 test
//= SM2-QOS-006 test
#[test]
fn a_subscriber_that_never_reads_costs_only_itself_and_every_loss_is_counted() {
    let domain = Domain::new();
    let (publisher, reader) = default_pair(&domain);
    // A background thread that still opens the link may take the first messages.
    let sleeper = (domain.builder("sleeper").background(false).connect()).unwrap();
    let asleep = sleeper.subscriber::<[u8]>("topic").unwrap();
    meet(&publisher, &[&reader, &asleep]);
    let rounds = 200;
    for seed in 0..rounds {
        let bytes = pattern(10_000, seed);
        assert_eq!(publisher.publish(&bytes).unwrap().links, 2);
        let sample = next(&reader);
        assert!(*sample == *bytes);
        assert_eq!(sample.lost(), 0);
    }
    // On the ring lane no message waits at the publisher.
    let timeout = if ring_lane() {
        SOON
    } else {
        Duration::from_millis(20)
    };
    assert_eq!(publisher.flush_timeout(timeout).unwrap(), ring_lane());
    let links = publisher.links();
    for link in &links {
        let it = link.counters;
        assert_eq!(it.offered, it.delivered + it.dropped() + it.in_flight);
        assert_eq!(it.offered, rounds);
    }
    assert_eq!(links[0].counters.delivered, rounds);
    // The window admits some messages, as many wait here, and the rest is lost. The ring holds the last
    // eight.
    let (lost, kept) = match ring_lane() {
        true => (links[1].counters.discarded, 8),
        false => (links[1].counters.overwritten, 8 + 4 + 8),
    };
    assert_eq!(links[1].counters.in_flight, kept);
    assert_eq!(lost, rounds - kept);
    assert_eq!(publisher.counters().offered, 2 * rounds);
    // The pool is just large enough for these messages.
    assert!(
        publisher.pool_bytes() <= 64 * (16 << 10),
        "{}",
        publisher.pool_bytes()
    );

    // When the subscriber continues, it gets the newest messages, and the number of lost ones.
    let (mut seen, mut last) = (0, 0);
    until(|| {
        publisher.counters();
        if let Some(sample) = asleep.try_recv().unwrap() {
            assert!(*sample == *pattern(10_000, sample.sequence() - 1));
            assert!(sample.sequence() > last);
            last = sample.sequence();
            seen += 1;
        }
        last == rounds
    });
    assert_eq!(asleep.lost() + seen, rounds);
}

/// In a ring, the publisher displaces them, and counts alone.
//= SM2-QOS-001 test
#[test]
fn a_subscriber_counts_what_it_displaces_itself() {
    let displaced = 8;
    for ring in LANES {
        let domain = Domain::new();
        let publisher = domain.node_on(ring, "talker").publisher::<u64>("topic");
        let publisher = publisher.unwrap();
        let listener = domain.builder("listener").ring_lane(ring);
        let listener = listener.background(false).connect().unwrap();
        let builder = listener.subscriber_builder::<u64>("topic").depth(1);
        let subscriber = builder.max_borrowed(8).declare().unwrap();
        meet(&publisher, &[&subscriber]);
        for number in 0..=displaced {
            publisher.publish(&number).unwrap();
        }
        assert_eq!(*next(&subscriber), displaced, "ring: {ring}");
        until(|| publisher.counters().discarded == displaced);
        let counted = subscriber.links()[0].received.discarded;
        assert_eq!(counted, if ring { 0 } else { displaced }, "ring: {ring}");
    }
}

//= SM2-QOS-002 test
#[test]
fn a_reliable_publisher_waits_until_its_deadline_for_each_link_alone() {
    let domain = Domain::new();
    let timeout = Duration::from_millis(100);
    let publisher = domain.node("talker");
    let publisher = publisher
        .publisher_builder::<[u8]>("topic")
        .depth(1)
        .reliable(true)
        .publish_timeout(timeout);
    let publisher = publisher.declare().unwrap();
    let stalled = domain
        .node("stalled")
        .subscriber_builder::<[u8]>("topic")
        .depth(1)
        .max_borrowed(1);
    let stalled = stalled.reliable(true).declare().unwrap();
    let best_effort = domain
        .node("best-effort")
        .subscriber::<[u8]>("topic")
        .unwrap();
    meet(&publisher, &[&stalled, &best_effort]);
    // Two in the window, one in the queue; on the ring lane, one in the ring.
    let room = if ring_lane() { 1 } else { 3 };
    for _ in 0..room {
        let published = publisher.publish(b"x").unwrap();
        assert_eq!((published.links, published.missed), (2, 0));
    }
    let calls = Injector::counting();
    let _installed = calls.install();
    let sleeps = || calls.counts().get(&Call::Poll).copied().unwrap_or(0);
    let start = Instant::now();
    let published = publisher.publish(b"late").unwrap();
    assert!(sleeps() > 0 && start.elapsed() >= timeout);
    assert_eq!((published.links, published.missed), (1, 1));
    assert!(published.complete().is_err());
    // The publisher does not wait for this link again,
    let before = sleeps();
    assert_eq!(publisher.publish(b"later").unwrap().missed, 1);
    assert_eq!(sleeps(), before);
    let all = [&b"x"[..], b"x", b"x", b"late", b"later"];
    for expected in &all[3 - room..] {
        assert_eq!(&*next(&best_effort), *expected);
    }
    // and sends on it once it has room again.
    assert_eq!(&*next(&stalled), b"x");
    assert_eq!(publisher.publish(b"again").unwrap().missed, 0);
    let counters = publisher.links()[0].counters;
    assert_eq!((counters.offered, counters.no_room), (room as u64 + 3, 2));
    let rest = [&b"x"[..], b"x", b"again"];
    for expected in &rest[3 - room..] {
        assert_eq!(&*next(&stalled), *expected);
        publisher.counters();
    }
    assert_eq!(stalled.lost(), 2);
}

#[test]
fn nothing_is_lost_on_a_reliable_link_with_a_slow_reader() {
    let domain = Domain::new();
    let (publisher, subscriber) = pair::<[u8]>(
        &domain,
        |node| {
            node.publisher_builder("topic")
                .depth(2)
                .reliable(true)
                .publish_timeout(SOON)
                .declare()
                .unwrap()
        },
        |node| {
            let builder = node.subscriber_builder("topic").depth(2).max_borrowed(2);
            builder.reliable(true).declare().unwrap()
        },
    );
    let reader = thread::spawn(move || {
        for seed in 0..100 {
            let sample = next(&subscriber);
            assert!(*sample == *pattern(5000, seed));
            if seed % 10 == 0 {
                thread::sleep(Duration::from_millis(2));
            }
        }
        assert_eq!(subscriber.lost(), 0);
    });
    for seed in 0..100 {
        publisher
            .publish(&pattern(5000, seed))
            .unwrap()
            .complete()
            .unwrap();
    }
    assert!(publisher.flush_timeout(SOON).unwrap());
    reader.join().unwrap();
}

//= SM2-MSG-005 test
#[test]
fn whoever_holds_too_many_samples_gets_no_more_and_is_told_so() {
    let domain = Domain::new();
    let (publisher, subscriber) = default_pair(&domain);
    let mut held = Vec::new();
    for seed in 0..6 {
        publisher.publish(&pattern(5000, seed)).unwrap();
    }
    for _ in 0..4 {
        held.push(next(&subscriber));
    }
    let error = subscriber.try_recv().unwrap_err();
    assert!(
        matches!(error, RecvError::TooManyBorrowed { held: 4, .. }),
        "{error}"
    );
    held.remove(0);
    assert!(*next(&subscriber) == *pattern(5000, 4));
    for (sample, seed) in held.iter().zip(1..) {
        assert!(**sample == *pattern(5000, seed));
    }
}
