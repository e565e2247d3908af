//! The ring lane as programs see it: late subscribers and publishers with both lanes get every byte, and
//! published messages outlive their publisher. (Waiting is tested in `ring_waits.rs`.)

use crate::common::{Domain, Endpoint, SOON, meet, next, number_in_slot, pattern, until};
use sm2_node::{Publisher, RecvError, Sample, Subscriber};

/// A publisher and a subscriber that both offer the ring lane, or both do not.
fn linked(domain: &Domain, ring: bool) -> (Publisher<[u8]>, Subscriber<[u8]>) {
    let publisher = domain.node_on(ring, "talker").publisher("topic").unwrap();
    let subscriber = domain
        .node_on(ring, "listener")
        .subscriber("topic")
        .unwrap();
    meet(&publisher, &[&subscriber]);
    (publisher, subscriber)
}

/// Returns which open links use the ring lane, by the name of the node at the other end.
fn rings(end: &dyn Endpoint) -> Vec<(String, bool)> {
    let links = end.links().into_iter().filter(|link| link.open);
    let mut rings: Vec<_> = links
        .map(|link| (link.peer.name.as_str().to_owned(), link.ring))
        .collect();
    rings.sort();
    rings
}

//= SM2-RNG-001 test
#[test]
fn the_ring_lane_is_used_if_both_sides_offer_it() {
    for (talker, listener) in [(true, true), (true, false), (false, true), (false, false)] {
        let domain = Domain::new();
        let publisher = domain.node_on(talker, "talker").publisher::<[u8]>("topic");
        let publisher = publisher.unwrap();
        let subscriber = domain.node_on(listener, "listener");
        let subscriber = subscriber.subscriber::<[u8]>("topic").unwrap();
        meet(&publisher, &[&subscriber]);
        let both = talker && listener;
        assert_eq!(rings(&publisher), [("listener".to_owned(), both)]);
        assert_eq!(rings(&subscriber), [("talker".to_owned(), both)]);
        for seed in 0..40 {
            let bytes = pattern(10_000 * (seed as usize % 3), seed);
            assert_eq!(publisher.publish(&bytes).unwrap().links, 1);
            assert!(*next(&subscriber) == *bytes);
        }
    }
}

/// The subscriber counts as linked before the publisher has read its answer. The publisher's other link is open, with
/// room in its ring, so the publisher would need no socket for the message.
#[test]
fn a_subscriber_that_counts_as_linked_gets_the_next_message() {
    let domain = Domain::new();
    // Each node handles its sockets in calls of this test only.
    let node = |name| {
        let builder = domain.builder(name).ring_lane(true).background(false);
        builder.connect().unwrap()
    };
    let publisher = node("talker").publisher::<[u8]>("topic").unwrap();
    let first = node("first").subscriber::<[u8]>("topic").unwrap();
    meet(&publisher, &[&first]);
    let linked = || {
        let links = publisher.links().into_iter();
        links.filter(|it| it.end.is_none()).count()
    };
    for turn in 0..20 {
        let listener = node("second");
        let second = listener.subscriber::<[u8]>("topic").unwrap();
        until(|| linked() == 2);
        second.wait_for_publishers_timeout(1, SOON).unwrap();
        let bytes = pattern(100, turn);
        assert_eq!(publisher.publish(&bytes).unwrap().links, 2, "turn {turn}");
        assert!(*next(&first) == *bytes);
        assert!(*next(&second) == *bytes);
        drop((second, listener));
        until(|| linked() == 1);
    }
}

/// Message lengths around the limits of each form and of each slot size.
const SIZES: [usize; 13] = [
    0,
    1,
    104,
    105,
    4_032,
    4_033,
    4_096,
    4_097,
    8_128,
    61_440,
    61_441,
    100_000,
    3 << 20,
];

#[test]
fn each_lane_gets_every_byte_of_one_publisher() {
    let domain = Domain::new();
    let talker = domain.node_on(true, "talker");
    let publisher = talker.publisher::<[u8]>("topic").unwrap();
    let ring = domain.node_on(true, "ring").subscriber::<[u8]>("topic");
    let socket = domain.node_on(false, "socket").subscriber::<[u8]>("topic");
    let sealed = domain
        .node_on(true, "sealed")
        .subscriber_builder::<[u8]>("topic");
    let (ring, socket) = (ring.unwrap(), socket.unwrap());
    let sealed = sealed.sealed(true).declare().unwrap();
    meet(&publisher, &[&ring, &socket, &sealed]);
    let names = ["ring", "sealed", "socket"].map(str::to_owned);
    let lanes: Vec<_> = names.into_iter().zip([true, false, false]).collect();
    assert_eq!(rings(&publisher), lanes);
    for (seed, len) in (1..).zip(SIZES.into_iter().chain(SIZES)) {
        let bytes = pattern(len, seed);
        let published = match seed % 2 {
            0 => publisher.publish(&bytes).unwrap(),
            _ => {
                let mut loan = publisher.loan_slice(len).unwrap();
                loan.copy_from_slice(&bytes);
                loan.publish().unwrap()
            }
        };
        assert_eq!(published.links, 3, "{len} bytes");
        for subscriber in [&ring, &socket, &sealed] {
            let sample = next(subscriber);
            assert!(*sample == *bytes, "{len} bytes");
            assert_eq!((sample.sequence(), sample.lost()), (seed, 0));
        }
    }
    assert!(publisher.flush_timeout(SOON).unwrap());
    for link in publisher.links() {
        assert_eq!((link.counters.offered, link.counters.delivered), (26, 26));
    }
}

/// A message in a segment of its own.
const LONGEST: usize = if cfg!(feature = "slow") {
    3 << 20
} else {
    1 << 20
};

/// Messages that were stored for no link, for a sealed link, or for the socket lane. A subscriber that comes
/// later needs them in a slot with a head.
//= SM2-QOS-005 test
#[test]
fn a_late_subscriber_gets_what_was_stored_in_any_form() {
    let lengths = [0, 10, 5_000, 100_000, LONGEST];
    for (before, sealed) in [("nobody", false), ("sealed", true), ("socket", false)] {
        for inline_max in [0, 61_440] {
            let domain = Domain::new();
            let talker = domain.node_on(true, "talker");
            let publisher = talker.publisher_builder::<[u8]>("map").latched(5);
            let publisher = publisher.inline_max(inline_max).declare().unwrap();
            let first = (before != "nobody").then(|| {
                let builder = domain
                    .node_on(false, before)
                    .subscriber_builder::<[u8]>("map");
                let first = builder.sealed(sealed).declare().unwrap();
                meet(&publisher, &[&first]);
                first
            });
            for (seed, len) in (0..).zip(lengths) {
                publisher.publish(&pattern(len, seed)).unwrap();
            }
            drop(first);
            until(|| publisher.links().iter().all(|link| !link.open));
            let late = domain
                .node_on(true, "late")
                .subscriber::<[u8]>("map")
                .unwrap();
            meet(&publisher, &[&late]);
            publisher.publish(b"live").unwrap();
            for (seed, len) in (0..).zip(lengths) {
                let sample = next(&late);
                assert!(*sample == *pattern(len, seed), "{before}, {len} bytes");
            }
            assert_eq!(*next(&late), *b"live");
        }
    }
}

//= SM2-MSG-005 test
#[test]
fn many_at_a_time_are_in_order_over_both_lanes_and_within_the_limits() {
    const EACH: u64 = 12;
    let domain = Domain::new();
    let listener = domain
        .node_on(true, "listener")
        .subscriber_builder::<[u64]>("topic");
    let listener = listener.depth(16).max_borrowed(4).declare().unwrap();
    let publishers = [("ring", true), ("socket", false)].map(|(name, ring)| {
        let publisher = domain.node_on(ring, name).publisher::<[u64]>("topic");
        publisher.unwrap()
    });
    until(|| {
        publishers.iter().for_each(|it| drop(it.links()));
        rings(&listener).len() == 2
    });
    for number in 1..=EACH {
        for publisher in &publishers {
            let message = number_in_slot(number);
            assert_eq!(publisher.publish(&message).unwrap().links, 1);
        }
    }
    let mut last = [0, 0];
    let mut check = |samples: &[Sample<[u64]>]| {
        for sample in samples {
            let place = usize::from(sample.publisher().as_str() == "socket");
            assert_eq!(sample[0], last[place] + 1, "{}", sample.publisher());
            last[place] = sample[0];
        }
        last == [EACH; 2]
    };
    let mut samples = Vec::new();
    assert_eq!(listener.try_recv_many(&mut samples, 0).unwrap(), 0);
    assert_eq!(listener.try_recv_many(&mut samples, 3).unwrap(), 3);
    check(&samples);
    // Sockets are read when the rings are empty: until then there may be four messages.
    until(|| {
        let before = samples.len();
        match listener.try_recv_many(&mut samples, 100) {
            Ok(count) => assert_eq!(samples.len(), before + count),
            Err(error) => assert!(matches!(error, RecvError::TooManyBorrowed { held: 4, .. })),
        }
        check(&samples[before..]);
        samples.len() == 8
    });
    let error = listener.try_recv_many(&mut samples, 1).unwrap_err();
    assert!(matches!(error, RecvError::TooManyBorrowed { held: 4, .. }));
    assert_eq!(
        samples.len(),
        8,
        "messages that were taken before stay in the list"
    );
    until(|| {
        samples.clear();
        match listener.try_recv_many(&mut samples, 5) {
            Ok(count) => assert!(count <= 5 && count == samples.len()),
            Err(error) => panic!("{error}"),
        }
        check(&samples)
    });
    assert_eq!(listener.lost(), 0);
    samples.clear();
    assert_eq!(listener.try_recv_many(&mut samples, 5).unwrap(), 0);
}

/// A message with a slot of several pages.
const LONG: usize = if cfg!(feature = "slow") {
    3 << 20
} else {
    100_000
};

/// Messages that are held or not taken, with and without their node, are compared byte by byte.
//= SM2-RNG-010 test
#[test]
fn what_was_published_outlives_its_publisher() {
    for ring in [true, false] {
        for len in [105, 5_000, LONG] {
            let domain = Domain::new();
            let (publisher, subscriber) = linked(&domain, ring);
            for seed in 1..=4 {
                publisher.publish(&pattern(len, seed)).unwrap();
            }
            let held: Vec<_> = (0..4).map(|_| next(&subscriber)).collect();
            for seed in 5..=25 {
                publisher.publish(&pattern(len, seed)).unwrap();
            }
            drop(publisher);
            until(|| subscriber.links().iter().all(|link| !link.open));
            for (seed, sample) in (1..).zip(&held) {
                assert!(**sample == *pattern(len, seed), "{seed}");
            }
            // As many messages as there is room for: on the ring lane, the last ones.
            assert!(matches!(
                subscriber.try_recv(),
                Err(RecvError::TooManyBorrowed { held: 4, .. })
            ));
            drop(held);
            let mut got = Vec::new();
            while let Some(sample) = subscriber.try_recv().unwrap() {
                assert!(*sample == *pattern(len, sample.sequence()));
                got.push(sample.sequence());
            }
            assert_eq!(got.len(), 8);
            assert!(got.windows(2).all(|it| it[0] + 1 == it[1]), "{got:?}");
            if ring {
                assert_eq!(got, (18..=25).collect::<Vec<_>>());
            }
            assert!(rings(&subscriber).is_empty());
        }
    }
}

#[test]
fn a_sample_outlives_its_subscriber() {
    for ring in [true, false] {
        let domain = Domain::new();
        let (publisher, subscriber) = linked(&domain, ring);
        publisher.publish(&pattern(10_000, 1)).unwrap();
        let sample = next(&subscriber);
        drop(subscriber);
        // Its slot is not used again.
        until(|| publisher.links().iter().all(|link| !link.open));
        let other = domain.node_on(ring, "other").subscriber::<[u8]>("topic");
        let other = other.unwrap();
        until(|| !other.links().is_empty() && publisher.publish(&[0; 10_000]).unwrap().links == 1);
        for _ in 0..40 {
            publisher.publish(&[0; 10_000]).unwrap();
            drop(next(&other));
        }
        drop(publisher);
        assert!(*sample == *pattern(10_000, 1), "ring lane: {ring}");
    }
}

/// Pseudo-random numbers that can be repeated.
struct Choice(u64);

impl Choice {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(1);
        (self.0 >> 33) % limit
    }
}

/// A publisher with little memory that needs slots of all sizes: segments come and go.
fn publisher_with_pool(domain: &Domain, ring: bool, bytes: u64) -> Publisher<[u8]> {
    let builder = domain
        .node_on(ring, "talker")
        .publisher_builder::<[u8]>("topic");
    builder.inline_max(0).pool_limit(bytes).declare().unwrap()
}

fn slot_by_slot(publisher: &Publisher<[u8]>, subscriber: &Subscriber<[u8]>, len: usize, byte: u8) {
    let bytes = vec![byte; len];
    assert_eq!(publisher.publish(&bytes).unwrap().links, 1, "{len} bytes");
    let sample = next(subscriber);
    assert!(*sample == *bytes, "{len} bytes");
    assert_eq!(sample.lost(), 0);
}

#[test]
fn messages_of_all_sizes_in_any_order_need_no_more_than_the_pool() {
    const LIMIT: u64 = 80 << 20;
    for ring in [true, false] {
        let domain = Domain::new();
        let publisher = publisher_with_pool(&domain, ring, LIMIT);
        let subscriber = domain.node_on(ring, "listener").subscriber::<[u8]>("topic");
        let subscriber = subscriber.unwrap();
        meet(&publisher, &[&subscriber]);
        let mut choice = Choice(1);
        for n in 0..200_u64 {
            // From one byte to 20 MB, with each order of magnitude equally likely.
            let most = 1 << choice.below(25);
            let len = (1 + choice.below(most)).min(20_000_000);
            slot_by_slot(&publisher, &subscriber, len as usize, n as u8);
            assert!(publisher.pool_bytes() <= LIMIT);
        }
        slot_by_slot(&publisher, &subscriber, 20_000_000, 7);
    }
}

/// Segment numbers are reused. A link uses a number again only after its receiver has reported that it
/// unmapped the segment.
//= SM2-RNG-009 test
//= SM2-RNG-003 test
#[test]
fn segments_may_be_more_than_there_are_numbers_for_them() {
    const LIMIT: u64 = 8 << 10;
    const AFTERWARDS: u32 = if cfg!(feature = "slow") { 600 } else { 100 };
    for ring in [true, false] {
        let domain = Domain::new();
        let publisher = publisher_with_pool(&domain, ring, LIMIT);
        let first = domain.node_on(false, "first").subscriber::<[u8]>("topic");
        let first = first.unwrap();
        meet(&publisher, &[&first]);
        // Two slots of one page, or one slot of two pages: there is no room for both.
        let len = |n: u32| if n.is_multiple_of(2) { 4_000 } else { 5_000 };
        for n in 0..32_700 {
            drop(publisher.loan_slice(len(n)).unwrap());
        }
        drop(first);
        let subscriber = domain.node_on(ring, "second").subscriber::<[u8]>("topic");
        let subscriber = subscriber.unwrap();
        until(|| {
            // Both nodes must be called.
            rings(&subscriber).len() & rings(&publisher).len() == 1
                && rings(&publisher) == [("second".to_owned(), ring)]
        });
        for n in 0..AFTERWARDS {
            slot_by_slot(&publisher, &subscriber, len(n), n as u8);
            assert_eq!(publisher.pool_bytes(), LIMIT);
        }
    }
}
