//! Many messages at a time: `publish_all` and `recv_each` have the effects of `publish` and `recv`.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::thread;
use std::time::Duration;

use crate::common::{Domain, SOON, in_slot, meet, pattern, until};
use serde::{Deserialize, Serialize, de, ser};
use sm2_node::{Message, PublishError, Publisher, RecvError, Schema, StoreError, Subscriber};
use sm2_proto::limits::CELL_MAX;

/// Returns a reliable publisher and a subscriber that may hold `held` messages.
fn linked(
    domain: &Domain,
    ring: bool,
    depth: u16,
    held: u16,
) -> (Publisher<[u8]>, Subscriber<[u8]>) {
    let publisher = domain.node_on(ring, "talker").publisher_builder("topic");
    let publisher = publisher
        .depth(depth)
        .reliable(true)
        .publish_timeout(SOON)
        .declare()
        .unwrap();
    let subscriber = domain.node_on(ring, "listener").subscriber_builder("topic");
    let subscriber = subscriber.depth(depth).max_borrowed(held).reliable(true);
    let subscriber = subscriber.declare().unwrap();
    meet(&publisher, &[&subscriber]);
    (publisher, subscriber)
}

/// Short and long messages, far more than there is room for: every byte arrives, in order, on both lanes.
//= SM2-QOS-002 test
#[test]
fn all_messages_come_in_their_order() {
    const MESSAGES: usize = if cfg!(feature = "slow") { 700 } else { 210 };
    let message = |number: usize| {
        let len = [0, 8, 104, 200, 5_000, 40_000, 70_000][number % 7];
        pattern(len, number as u64)
    };
    for (ring, depth) in [(true, 7), (true, 64), (false, 7)] {
        let domain = Domain::new();
        let (publisher, subscriber) = linked(&domain, ring, depth, 5);
        let talker = thread::spawn(move || {
            let all: Vec<_> = (0..MESSAGES).map(message).collect();
            let published = publisher.publish_all(all.iter().map(Vec::as_slice));
            let published = published.unwrap();
            assert_eq!((published.links, published.missed), (1, 0));
            let flushed = publisher.flush_timeout(SOON).unwrap();
            assert!(flushed, "all of them were released");
            assert_eq!(publisher.counters().delivered, MESSAGES as u64);
        });
        let mut number = 0;
        while number < MESSAGES {
            let before = number;
            let seen = subscriber.recv_each_timeout(9, SOON, |sample| {
                assert!(**sample.unwrap() == *message(number), "message {number}");
                number += 1;
            });
            assert_eq!(seen.unwrap(), number - before);
            // In a ring, a short message is copied, so that it is not held.
            let is_held = |number: &usize| !ring || message(*number).len() > CELL_MAX;
            let held = (before..number).filter(is_held).count();
            assert!(number > before && held <= 5, "no more than it may hold");
        }
        talker.join().unwrap();
        assert_eq!(subscriber.lost(), 0);
    }
}

#[test]
fn whoever_has_no_room_misses_what_others_get() {
    for ring in [true, false] {
        let domain = Domain::new();
        let publisher = domain
            .node_on(ring, "talker")
            .publisher_builder::<[u8]>("topic");
        let timeout = Duration::from_millis(30);
        let publisher = publisher
            .depth(4)
            .reliable(true)
            .publish_timeout(timeout)
            .declare()
            .unwrap();
        let [stopped, quick] = [("stopped", 4), ("quick", 64)].map(|(name, depth)| {
            let subscriber = domain
                .node_on(ring, name)
                .subscriber_builder::<[u8]>("topic");
            let subscriber = subscriber.depth(depth).max_borrowed(1).reliable(true);
            subscriber.declare().unwrap()
        });
        meet(&publisher, &[&stopped, &quick]);
        let all: Vec<_> = (0..20).map(|seed| pattern(128, seed)).collect();
        let published = publisher
            .publish_all(all.iter().map(Vec::as_slice))
            .unwrap();
        assert_eq!(published.links, 1, "links of the last one");
        let sent = publisher
            .links()
            .iter()
            .map(|it| it.counters.no_room)
            .sum::<u64>();
        assert_eq!(published.missed as u64, sent);
        assert!((1..20).contains(&published.missed));
        for message in &all {
            assert!(*quick.recv_timeout(SOON).unwrap().unwrap() == **message);
        }
        assert!(published.complete().is_err());
    }
}

#[test]
fn nothing_to_send_and_nothing_to_see() {
    let domain = Domain::new();
    let (publisher, subscriber) = linked(&domain, true, 8, 4);
    let published = publisher.publish_all([]).unwrap();
    assert_eq!((published.links, published.missed), (0, 0));
    let panics = |_: Result<&sm2_node::Sample<[u8]>, RecvError>| panic!("there is no message");
    let none = |most, timeout| subscriber.recv_each_timeout(most, timeout, panics);
    assert_eq!(subscriber.try_recv_each(8, panics).unwrap(), 0);
    assert_eq!(none(8, Duration::from_millis(5)).unwrap(), 0);
    let unlimited = subscriber.recv_each(0, panics);
    assert_eq!(unlimited.unwrap(), 0, "no more than asked for");
    let message = in_slot(b"one");
    publisher.publish_all([&message[..], &message]).unwrap();
    let held = subscriber.recv_timeout(SOON).unwrap().unwrap();
    let rest: [_; 3] = std::array::from_fn(|_| {
        publisher.publish(&message).unwrap();
        subscriber.recv_timeout(SOON).unwrap().unwrap()
    });
    publisher.publish(&message).unwrap();
    let full = none(8, SOON).unwrap_err();
    assert!(matches!(full, RecvError::TooManyBorrowed { held: 4, .. }));
    drop((held, rest));
}

/// A panic during a batch releases the whole batch.
//= SM2-MSG-005 test
#[test]
fn a_batch_is_given_back_whatever_happens() {
    for ring in [true, false] {
        let domain = Domain::new();
        let (publisher, subscriber) = linked(&domain, ring, 8, 4);
        let messages = [b"a", b"b", b"c"].map(|it| in_slot(it));
        for round in 0..5 {
            publisher
                .publish_all(messages.iter().map(Vec::as_slice))
                .unwrap();
            let seen = Cell::new(0);
            let look = || {
                subscriber.recv_each_timeout(8, SOON, |sample| {
                    seen.set(seen.get() + 1);
                    assert_ne!(sample.unwrap()[0], b'b', "the panic that this test needs");
                })
            };
            assert!(catch_unwind(AssertUnwindSafe(look)).is_err());
            assert_eq!(seen.get(), 2, "round {round}");
            until(|| publisher.counters().in_flight == 0);
        }
        assert_eq!(publisher.counters().delivered, 15);
    }
}

/// While `each` runs, the node can be called, and borrowed messages do not change.
#[test]
fn the_node_is_free_while_a_message_is_looked_at() {
    let domain = Domain::new();
    let (publisher, subscriber) = linked(&domain, true, 8, 4);
    publisher.publish_all([&[1; 128][..], &[2; 128]]).unwrap();
    let mut seen = Vec::new();
    subscriber
        .recv_each_timeout(8, SOON, |sample| {
            let sample = sample.unwrap();
            publisher.publish(&[9; 128]).unwrap();
            assert_eq!(subscriber.lost(), 0);
            assert!(sample.iter().all(|byte| *byte == sample[0]));
            seen.push(sample[0]);
        })
        .unwrap();
    assert_eq!(seen, [1, 2]);
}

/// A number that sometimes cannot be encoded or decoded.
#[derive(Message, Serialize, Deserialize, Debug)]
#[message(name = "test/Picky", encoding = "postcard")]
struct Picky(Number);

#[derive(Schema, Debug, PartialEq, Clone, Copy)]
struct Number(u32);

const UNWRITABLE: u32 = 40;
const UNREADABLE: u32 = 7;

impl Serialize for Number {
    fn serialize<S: ser::Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        match self.0 {
            UNWRITABLE => Err(ser::Error::custom("not this one")),
            number => to.serialize_u32(number),
        }
    }
}

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: de::Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        match u32::deserialize(from)? {
            UNREADABLE => Err(de::Error::custom("not this one")),
            number => Ok(Self(number)),
        }
    }
}

/// A message that cannot be encoded does not affect those before it. A message that cannot be decoded does
/// not affect those after it.
#[test]
fn a_message_that_is_none_costs_no_other() {
    let domain = Domain::new();
    let publisher = domain
        .node_on(true, "talker")
        .publisher_builder::<Picky>("topic");
    let publisher = publisher.depth(64).declare().unwrap();
    let [lent, taken] = ["lent", "taken"].map(|name| {
        let subscriber = domain
            .node_on(true, name)
            .subscriber_builder::<Picky>("topic");
        subscriber.depth(64).max_borrowed(64).declare().unwrap()
    });
    meet(&publisher, &[&lent, &taken]);
    let all: Vec<_> = (0..50).map(|number| Picky(Number(number))).collect();
    let error = publisher.publish_all(&all).unwrap_err();
    assert!(
        matches!(error, PublishError::Store(StoreError::Encode(_))),
        "{error}"
    );
    let (mut numbers, mut errors) = (Vec::new(), Vec::new());
    let seen = lent.recv_each_timeout(64, SOON, |sample| match sample {
        Ok(sample) => numbers.push(sample.0.0),
        Err(error) => errors.push((numbers.len(), error)),
    });
    let readable = |number: &u32| *number != UNREADABLE;
    let wanted: Vec<_> = (0..UNWRITABLE).filter(readable).collect();
    assert_eq!((seen.unwrap(), &numbers), (40, &wanted));
    assert!(
        matches!(&errors[..], [(7, RecvError::Payload { .. })]),
        "{errors:?}"
    );
    let mut samples = Vec::new();
    let error = taken.try_recv_many(&mut samples, 64).unwrap_err();
    assert!(matches!(error, RecvError::Payload { .. }), "{error}");
    let numbers: Vec<_> = samples.iter().map(|sample| sample.0.0).collect();
    assert_eq!(
        numbers, wanted,
        "also those behind the one that cannot be read"
    );
}

/// A group of short messages is published under one lock, so it has one time. That is so for reliable links as well, as
/// long as they have room.
#[test]
fn a_group_of_short_messages_has_one_time() {
    let domain = Domain::new();
    let (publisher, subscriber) = linked(&domain, true, 64, 5);
    let message: &[u8] = b"short";
    publisher.publish_all([message; 32]).unwrap();
    let mut times = Vec::new();
    until(|| {
        while let Some(sample) = subscriber.try_recv().unwrap() {
            times.push(sample.source_time());
        }
        times.len() == 32
    });
    assert!(times.iter().all(|it| *it == times[0]), "{times:?}");
}

/// A message that finds no room in the ring of a reliable link waits for it.
#[test]
fn a_reliable_link_without_room_delays_its_group() {
    let domain = Domain::new();
    let (publisher, subscriber) = linked(&domain, true, 2, 1);
    let messages: Vec<[u8; 1]> = (0..32).map(|number| [number]).collect();
    thread::scope(|scope| {
        scope.spawn(|| publisher.publish_all(messages.iter().map(|it| &it[..])));
        for message in &messages {
            let sample = subscriber.recv_timeout(SOON).unwrap().expect("a message");
            assert_eq!((&*sample, sample.lost()), (&message[..], 0));
        }
    });
    assert_eq!(publisher.counters().dropped(), 0);
}
