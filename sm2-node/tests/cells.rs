//! Short messages in the cells of a ring, as programs see them: they need no memory of the publisher, and are never
//! held there.

use std::time::Duration;

use crate::common::{
    Domain, Endpoint, LANES, SOON, in_slot, meet, next, next_request, pattern, until,
};
use sm2_io::fault::{Call, Injector};
use sm2_node::zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};
use sm2_node::{
    CallError, Message, Node, Plain, Publisher, RecvError, Sample, Subscriber, SubscriberBuilder,
};
use sm2_proto::limits::CELL_MAX;
use sm2_proto::link::Counters;
use sm2_test_support::seed;

/// A node of the ring lane that the calls of this test drive alone.
fn node(domain: &Domain, name: &str) -> Node {
    let builder = domain.builder(name).ring_lane(true).background(false);
    builder.connect().unwrap()
}

/// A publisher and a subscriber that may hold this many samples.
fn linked<T: Message + ?Sized>(
    domain: &Domain,
    max_borrowed: u16,
) -> (Publisher<T>, Subscriber<T>) {
    let publisher = node(domain, "talker").publisher("topic").unwrap();
    let builder = node(domain, "listener").subscriber_builder("topic");
    let builder = builder.depth(64).max_borrowed(max_borrowed);
    let subscriber = builder.declare().unwrap();
    meet(&publisher, &[&subscriber]);
    (publisher, subscriber)
}

//= SM2-RNG-013 test
#[test]
fn a_short_message_needs_neither_memory_nor_a_packet() {
    let domain = Domain::new();
    let (publisher, subscriber) = linked::<[u8]>(&domain, 4);
    let calls = Injector::counting();
    let packets = || calls.counts().get(&Call::SendMsg).copied().unwrap_or(0);
    for (len, needs_slot) in [
        (0, false),
        (1, false),
        (CELL_MAX, false),
        (CELL_MAX + 1, true),
    ] {
        let message = pattern(len, 1);
        calls.set(None);
        let installed = calls.install();
        assert_eq!(publisher.publish(&message).unwrap().links, 1);
        drop(installed);
        // A segment is announced by a packet.
        assert_eq!(packets() > 0, needs_slot, "{len} bytes");
        assert_eq!(publisher.pool_bytes() > 0, needs_slot, "{len} bytes");
        assert!(*next(&subscriber) == *message, "{len} bytes");
    }
}

//= SM2-RNG-013, SM2-MSG-005 test
#[test]
fn a_short_sample_is_not_held() {
    let domain = Domain::new();
    let (publisher, subscriber) = linked::<[u8]>(&domain, 1);
    let mut short = Vec::new();
    for seed in 0..200 {
        publisher.publish(&pattern(CELL_MAX, seed)).unwrap();
        short.push(next(&subscriber));
    }
    let all = Counters {
        offered: 200,
        delivered: 200,
        ..Counters::default()
    };
    assert_eq!((publisher.counters(), publisher.pool_bytes()), (all, 0));
    // A long sample is held, and does not keep the program from taking short ones.
    for message in [in_slot(b"held"), b"short".to_vec(), in_slot(b"too many")] {
        publisher.publish(&message).unwrap();
    }
    let long = next(&subscriber);
    assert_eq!(*next(&subscriber), *b"short");
    let error = subscriber.try_recv().unwrap_err();
    assert!(
        matches!(error, RecvError::TooManyBorrowed { held: 1, .. }),
        "{error}"
    );
    drop(long);
    assert_eq!(*next(&subscriber), *in_slot(b"too many"));
    drop((subscriber, publisher, domain));
    for (seed, sample) in (0..).zip(&short) {
        assert!(**sample == *pattern(CELL_MAX, seed), "{seed}");
        assert_eq!((sample.sequence(), sample.lost()), (seed + 1, 0));
        assert_eq!(sample.publisher().as_str(), "talker");
    }
}

/// The counts of both ends, for messages in cells and for those in slots that are dropped at once.
//= SM2-RNG-013, SM2-QOS-006 test
#[test]
fn short_messages_are_counted_as_long_ones() {
    for len in [CELL_MAX, CELL_MAX + 1] {
        let domain = Domain::new();
        let (talker, listener) = (node(&domain, "talker"), node(&domain, "listener"));
        let publisher = talker.publisher::<[u8]>("topic").unwrap();
        let builder = listener.subscriber_builder::<[u8]>("topic").depth(4);
        let subscriber = builder.declare().unwrap();
        meet(&publisher, &[&subscriber]);
        let check = |delivered, discarded, in_flight| {
            let expected = Counters {
                offered: delivered + discarded + in_flight,
                delivered,
                discarded,
                in_flight,
                ..Counters::default()
            };
            assert_eq!(publisher.counters(), expected, "{len} bytes");
            // A tool that does not drive the node sees the same.
            let view = listener.inspect(talker.id().unwrap()).unwrap().unwrap();
            let entries: Vec<_> = view.entries().map(|it| it.1.unwrap()).collect();
            assert_eq!((entries.len(), entries[1].fates), (2, expected));
        };
        let publish = || assert_eq!(publisher.publish(&pattern(len, 1)).unwrap().links, 1);
        (0..3).for_each(|_| publish());
        check(0, 0, 3);
        drop(next(&subscriber));
        check(1, 0, 2);
        // The subscriber keeps the last four.
        (0..5).for_each(|_| publish());
        check(1, 3, 4);
        let sample = next(&subscriber);
        assert_eq!((sample.sequence(), sample.lost()), (5, 3));
        drop(sample);
        check(2, 3, 3);
        (0..3).for_each(|_| drop(next(&subscriber)));
        check(5, 3, 0);
        let received = subscriber.links()[0].received;
        assert_eq!((received.messages, received.bytes), (5, 5 * len as u64));
        assert_eq!(subscriber.lost(), 3);
    }
}

#[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout, Debug, PartialEq, Clone, Copy)]
#[message(name = "test/Half")]
#[repr(C, align(32))]
struct Half([u64; 8]);

#[derive(Message, FromBytes, IntoBytes, Immutable, KnownLayout, Debug, PartialEq, Clone, Copy)]
#[message(name = "test/Line")]
#[repr(C, align(64))]
struct Line([u64; 8]);

/// Publishes this message, and moves its samples about before they are read.
fn survives_moves<T: Plain + PartialEq + std::fmt::Debug + ?Sized>(message: &T) {
    let domain = Domain::new();
    let (publisher, subscriber) = linked::<T>(&domain, 1);
    let mut samples: Vec<Sample<T>> = Vec::new();
    for _ in 0..33 {
        publisher.publish(message).unwrap();
        // A vector that grows moves its elements.
        samples.push(next(&subscriber));
        samples.shrink_to_fit();
        for sample in &samples {
            assert_eq!(&**sample, message);
            let address = std::ptr::from_ref::<T>(sample).cast::<u8>().addr();
            assert!(address.is_multiple_of(align_of_val(message)));
        }
    }
    assert_eq!(publisher.pool_bytes(), 0, "they were in cells");
    let boxed: Vec<_> = samples.into_iter().rev().map(Box::new).collect();
    assert!(boxed.iter().all(|sample| ***sample == *message));
}

#[test]
fn a_sample_in_a_cell_is_read_after_it_was_moved() {
    survives_moves(&7_u8);
    survives_moves(&0x0123_4567_u64);
    survives_moves(&(u128::MAX / 3));
    survives_moves(&[1_u128, 2, 3][..]);
    survives_moves(&[0.5_f64; 13][..]);
    survives_moves(&Half([3; 8]));
    survives_moves(&Line([4; 8]));
    survives_moves(&[Line([5; 8])][..]);
    survives_moves::<[Line]>(&[]);
}

/// A publisher with latched messages stores them all, for those who come late.
//= SM2-QOS-005, SM2-RNG-013 test
#[test]
fn a_late_subscriber_gets_the_short_messages_that_another_one_had() {
    let domain = Domain::new();
    let builder = node(&domain, "talker").publisher_builder::<[u8]>("map");
    let publisher = builder.latched(3).declare().unwrap();
    let subscribe = |name| node(&domain, name).subscriber::<[u8]>("map").unwrap();
    let early = subscribe("early");
    meet(&publisher, &[&early]);
    let lengths = [10, 200, CELL_MAX, 0, CELL_MAX + 1];
    for (seed, len) in (0..).zip(lengths) {
        publisher.publish(&pattern(len, seed)).unwrap();
        assert!(*next(&early) == *pattern(len, seed));
    }
    let late = subscribe("late");
    meet(&publisher, &[&early, &late]);
    for (seed, len) in (0..).zip(lengths).skip(2) {
        let sample = next(&late);
        assert!(*sample == *pattern(len, seed), "{seed}");
        assert_eq!(sample.sequence(), seed + 1);
    }
    assert!(early.try_recv().unwrap().is_none() && late.try_recv().unwrap().is_none());
}

/// Which subscriber a publisher has.
#[derive(Clone, Copy, Debug)]
enum Kind {
    Ring,
    Sealed,
    Socket,
    Reliable,
}

fn subscriber(domain: &Domain, kind: Kind) -> Subscriber<[u8]> {
    let name = format!("{kind:?}").to_lowercase();
    let builder = domain.builder(&name).background(false);
    let builder = builder.ring_lane(!matches!(kind, Kind::Socket));
    let node = builder.connect().unwrap();
    let builder: SubscriberBuilder<[u8]> = node.subscriber_builder("topic").depth(64);
    let builder = builder.sealed(matches!(kind, Kind::Sealed));
    let builder = builder.reliable(matches!(kind, Kind::Reliable));
    builder.declare().unwrap()
}

/// Takes all messages that are there, and checks that each is the one that was published with its number.
fn take_all(subscriber: &Subscriber<[u8]>, published: &[Vec<u8>], last: &mut u64) -> u64 {
    let mut taken = 0;
    while let Some(sample) = subscriber.try_recv().unwrap() {
        let number = sample.sequence();
        assert!(number > *last, "{number} after {last}");
        assert_eq!(sample.lost(), number - *last - 1, "before {number}");
        assert!(
            *sample == *published[number as usize - 1],
            "message {number}"
        );
        *last = number;
        taken += 1;
    }
    taken
}

/// A publisher with all kinds of links, and one subscriber that takes its messages now and then.
//= SM2-RNG-013, SM2-MSG-002, SM2-QOS-001 test
#[test]
fn each_link_of_a_publisher_gets_messages_of_all_lengths_in_order() {
    const MESSAGES: usize = if cfg!(feature = "slow") { 4_000 } else { 400 };
    let mut state = seed();
    let mut below = |limit: u64| {
        state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
        (state >> 33) % limit
    };
    let sets: [&[Kind]; 3] = [
        &[Kind::Ring, Kind::Reliable],
        &[Kind::Ring, Kind::Reliable, Kind::Sealed],
        &[Kind::Ring, Kind::Reliable, Kind::Socket, Kind::Sealed],
    ];
    for kinds in sets {
        let domain = Domain::new();
        let talker = node(&domain, "talker");
        let builder = talker.publisher_builder::<[u8]>("topic").reliable(true);
        let publisher = builder.depth(64).declare().unwrap();
        let prompt: Vec<_> = kinds
            .iter()
            .map(|kind| subscriber(&domain, *kind))
            .collect();
        let builder = node(&domain, "slow").subscriber_builder::<[u8]>("topic");
        let slow = builder.depth(3).declare().unwrap();
        let mut ends: Vec<&dyn Endpoint> = prompt.iter().map(|it| it as &dyn Endpoint).collect();
        ends.push(&slow);
        meet(&publisher, &ends);
        let mut published = Vec::new();
        let (mut lasts, mut last) = (vec![0; prompt.len()], 0);
        let mut taken = 0;
        while published.len() < MESSAGES {
            let lengths = [0, 8, CELL_MAX - 1, CELL_MAX, CELL_MAX + 1, 300, 5_000];
            for _ in 0..=below(4) {
                let len = lengths[below(lengths.len() as u64) as usize];
                let message = pattern(len, published.len() as u64);
                let result = if below(5) == 0 {
                    let mut loan = publisher.loan_slice(len).unwrap();
                    loan.copy_from_slice(&message);
                    loan.publish().unwrap()
                } else {
                    publisher.publish(&message).unwrap()
                };
                assert_eq!((result.links, result.missed), (ends.len(), 0));
                published.push(message);
            }
            for (subscriber, last) in prompt.iter().zip(&mut lasts) {
                until(|| {
                    // Drives the node of the publisher.
                    publisher.links();
                    take_all(subscriber, &published, last);
                    *last == published.len() as u64
                });
                assert_eq!(subscriber.lost(), 0);
            }
            if below(6) == 0 {
                taken += take_all(&slow, &published, &mut last);
            }
        }
        taken += take_all(&slow, &published, &mut last);
        assert_eq!(last, published.len() as u64, "the newest one is kept");
        assert_eq!(taken + slow.lost(), published.len() as u64);
        for link in publisher.links() {
            let it = link.counters;
            assert_eq!(it.offered, published.len() as u64, "{}", link.peer.name);
            assert_eq!(it.offered, it.delivered + it.dropped() + it.in_flight);
        }
    }
}

/// Calls whose replies no thread waits for any more, late requests, and failures with short and long reasons.
//= SM2-RNG-013, SM2-SRV-001, SM2-SRV-002, SM2-SRV-003 test
#[test]
fn calls_of_all_lengths_end_once() {
    for ring in LANES {
        let domain = Domain::new();
        let node = |name| domain.builder(name).ring_lane(ring).background(false);
        let server = node("server").connect().unwrap();
        let server = server.server::<[u8], [u8]>("echo").unwrap();
        let client = node("client").connect().unwrap();
        let client = client.client::<[u8], [u8]>("echo").unwrap();
        meet(&client, &[&server]);
        let mut calls = 0;
        for (asked, answered) in [(1, 1), (1, 200), (200, 1), (200, 200)] {
            let send = || client.send_timeout(&pattern(asked, 1), SOON).unwrap();
            let reply = pattern(answered, 2);
            // A reply that comes after its call was dropped.
            let call = send();
            let request = next_request(&server);
            drop(call);
            request.reply(&reply).unwrap();
            // The server gets no late request. A cancelled one may be there before its cancellation.
            drop(client.send_timeout(&pattern(asked, 4), SOON).unwrap());
            let late = client.send_timeout(&pattern(asked, 3), Duration::ZERO);
            let call = send();
            let mut request = next_request(&server);
            if *request == *pattern(asked, 4) {
                request.reply(&reply).unwrap();
                request = next_request(&server);
            }
            assert!(*request == *pattern(asked, 1));
            request.reply(&reply).unwrap();
            assert!(*call.wait().unwrap() == *reply);
            let error = late.unwrap().wait().unwrap_err();
            assert!(
                matches!(error, CallError::DeadlineExceeded { .. }),
                "{error}"
            );
            // A failure, and a request that is dropped.
            let reason = "no ".repeat(answered);
            let failing = send();
            next_request(&server).fail(&reason).unwrap();
            let dropped = send();
            drop(next_request(&server));
            for (call, expected) in [(failing, &*reason), (dropped, "dropped")] {
                match call.wait().unwrap_err() {
                    CallError::Failed { reason, .. } => {
                        assert!(reason.contains(expected), "{reason}");
                    }
                    error => panic!("{error}"),
                }
            }
            calls += 6;
            let counters = client.links()[0].counters;
            assert_eq!((counters.offered, counters.in_flight), (calls, 0));
        }
        // The program may hold any number of short replies, and each stays as it is.
        let mut replies = Vec::new();
        for number in 0..100 {
            let call = client.send_timeout(&pattern(8, number), SOON).unwrap();
            let request = next_request(&server);
            let bytes = request.to_vec();
            request.reply(&bytes).unwrap();
            let reply = call.wait().unwrap();
            if ring {
                replies.push(reply);
            }
        }
        for (number, reply) in (0..).zip(&replies) {
            assert!(**reply == *pattern(8, number));
        }
    }
}
