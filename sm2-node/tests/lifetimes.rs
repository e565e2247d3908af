//! Objects that are dropped in different orders, threads that share a node, and a node without a Manager.

use std::borrow::Cow;
use std::sync::{Mutex, mpsc};
use std::thread;
use std::time::{Duration, Instant};

use crate::common::{Domain, SOON, meet, next, pair, pattern, until};
use sm2_node::{EncodeError, Message, Payload, PayloadError, SharedBytes};
use sm2_proto::Contract;

//= SM2-OPN-009, SM2-OPN-010 test
#[test]
fn a_sample_stays_as_it_is_when_all_else_is_gone() {
    let domain = Domain::new();
    for sealed in [false, true] {
        let (publisher, subscriber) = pair::<[u8]>(
            &domain,
            |node| {
                node.publisher_builder("topic")
                    .sealed(sealed)
                    .declare()
                    .unwrap()
            },
            |node| node.subscriber("topic").unwrap(),
        );
        publisher.publish(&pattern(50_000, 1)).unwrap();
        publisher.publish(&pattern(50_000, 2)).unwrap();
        let sample = next(&subscriber);
        // The second message is neither taken nor released.
        drop(subscriber);
        // If the slot counted as free, the publisher would use it again: it needs as many slots as a
        // subscriber that does not read can occupy.
        let again = domain
            .node("listener-2")
            .subscriber::<[u8]>("topic")
            .unwrap();
        meet(&publisher, &[&again]);
        for seed in 3..40 {
            publisher.publish(&pattern(50_000, seed)).unwrap();
        }
        assert!(*sample == *pattern(50_000, 1));
        for _ in 0..8 {
            let other = next(&again);
            assert!(*other == *pattern(50_000, other.sequence()));
        }
        drop(publisher);
        assert!(*sample == *pattern(50_000, 1));
    }
}

/// A manual implementation that keeps its payload for longer than its sample.
struct Keeper(Vec<u8>);

static KEPT: Mutex<Vec<Payload>> = Mutex::new(Vec::new());

impl Message for Keeper {
    const NAME: &'static str = "keeper";
    const HASH: u64 = 1;
    type View = Box<Self>;

    fn bytes(&self) -> Result<Cow<'_, [u8]>, EncodeError> {
        Ok(Cow::Borrowed(&self.0))
    }

    fn view(payload: Payload) -> Result<Box<Self>, PayloadError> {
        let view = Self(payload.to_vec());
        KEPT.lock().unwrap().push(payload);
        Ok(Box::new(view))
    }
}

/// A slot is written again once its sample is dropped. A program can keep only a copy.
//= SM2-PAY-005 test
#[test]
fn a_payload_that_outlives_its_sample_stays_as_it_is() {
    let domain = Domain::new();
    let (publisher, subscriber) = pair::<Keeper>(
        &domain,
        |node| {
            let builder = node.publisher_builder("topic");
            builder.inline_max(0).declare().unwrap()
        },
        |node| node.subscriber("topic").unwrap(),
    );
    for seed in 0..20 {
        publisher.publish(&Keeper(pattern(5000, seed))).unwrap();
        assert!(next(&subscriber).0 == pattern(5000, seed));
    }
    for (seed, payload) in KEPT.lock().unwrap().iter().enumerate() {
        assert!(**payload == *pattern(5000, seed as u64), "{seed}");
    }
}

/// A message, and the parts of it that were read out of the memory of its publisher.
struct Parts {
    bytes: Vec<u8>,
    inside: Vec<(usize, Vec<u8>)>,
}

impl Message for Parts {
    const NAME: &'static str = "parts";
    const HASH: u64 = 2;
    type View = Box<Self>;

    fn bytes(&self) -> Result<Cow<'_, [u8]>, EncodeError> {
        Ok(Cow::Borrowed(&self.bytes))
    }

    fn view(_: Payload) -> Result<Box<Self>, PayloadError> {
        unreachable!("`decode` reads all messages")
    }

    fn decode(bytes: &SharedBytes<'_>) -> Option<Result<Box<Self>, PayloadError>> {
        let len = bytes.len();
        let inside = [(0, 0), (0, len), (7, 5), (len - 3, 3), (len, 0)].map(|(start, part)| {
            let mut copy = vec![0; part];
            assert!(bytes.copy_to(start, &mut copy), "{start} {part}");
            assert_eq!(bytes.to_vec(start, part).unwrap(), copy);
            (start, copy)
        });
        for (start, part) in [
            (0, len + 1),
            (len - 3, 4),
            (len, 1),
            (len + 1, 0),
            (usize::MAX, 1),
        ] {
            assert!(!bytes.copy_to(start, &mut vec![0; part]), "{start} {part}");
            assert!(bytes.to_vec(start, part).is_none(), "{start} {part}");
        }
        let bytes = bytes.to_vec(0, len).unwrap();
        let inside = inside.to_vec();
        Some(Ok(Box::new(Self { bytes, inside })))
    }
}

/// A message is read within its own bytes, in whichever memory it is: a slot is longer, and others are beside it.
#[test]
fn parts_of_a_message_are_those_inside() {
    let domain = Domain::new();
    for (sealed, inline_max) in [(false, 61_440), (false, 0), (true, 0)] {
        let (publisher, subscriber) = pair::<Parts>(
            &domain,
            |node| {
                let builder = node.publisher_builder("topic");
                let builder = builder.sealed(sealed).inline_max(inline_max);
                builder.declare().unwrap()
            },
            |node| node.subscriber("topic").unwrap(),
        );
        for len in [12, 13, 1_000, 5_000] {
            let bytes = pattern(len, len as u64);
            let inside = Vec::new();
            publisher.publish(&Parts { bytes, inside }).unwrap();
            let sample = next(&subscriber);
            let bytes = pattern(len, len as u64);
            assert!(sample.bytes == bytes, "{len}");
            for (start, part) in &sample.inside {
                assert!(bytes[*start..][..part.len()] == **part, "{len} {start}");
            }
        }
    }
}

//= SM2-TRN-005, SM2-OPN-007, SM2-LNK-005 test
#[test]
fn what_was_sent_before_the_publisher_went_is_received() {
    let domain = Domain::new();
    for (sealed, inline_max) in [(false, 61_440), (false, 0), (true, 0)] {
        let (publisher, subscriber) = pair::<[u8]>(
            &domain,
            |node| {
                let builder = node.publisher_builder("topic").sealed(sealed);
                builder.inline_max(inline_max).declare().unwrap()
            },
            |node| node.subscriber("topic").unwrap(),
        );
        for seed in 0..8 {
            publisher.publish(&pattern(5000, seed)).unwrap();
        }
        drop(publisher);
        // The Manager's frame arrives before the link is read: the Manager sends it when it forgets the publisher.
        let watcher = domain.node("watcher");
        until(|| {
            let domain = watcher.snapshot().unwrap();
            let is_publisher = |it: &Contract| matches!(it, Contract::Publisher { .. });
            !domain.interfaces().any(|it| is_publisher(it.contract))
        });
        for seed in 0..8 {
            assert!(*next(&subscriber) == *pattern(5000, seed), "{seed}");
        }
        assert!(subscriber.try_recv().unwrap().is_none());
        assert_eq!(subscriber.lost(), 0);
    }
}

#[test]
fn two_threads_of_one_node_both_get_their_messages() {
    let domain = Domain::new();
    let talker = domain.node("talker");
    let listener = domain.node("listener");
    let topics = ["a", "b", "c"];
    let publishers: Vec<_> = topics
        .iter()
        .map(|topic| {
            talker
                .publisher_builder::<[u8]>(topic)
                .reliable(true)
                .publish_timeout(SOON)
                .declare()
                .unwrap()
        })
        .collect();
    let (ready, opened) = mpsc::channel();
    let readers: Vec<_> = topics
        .iter()
        .map(|topic| {
            let builder = listener.subscriber_builder::<[u8]>(topic).reliable(true);
            let subscriber = builder.declare().unwrap();
            let ready = ready.clone();
            thread::spawn(move || {
                subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
                ready.send(()).unwrap();
                for seed in 0..300 {
                    assert!(*next(&subscriber) == *pattern(16, seed));
                }
            })
        })
        .collect();
    for publisher in &publishers {
        publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    }
    for _ in topics {
        opened.recv_timeout(SOON).unwrap();
    }
    for seed in 0..300 {
        for publisher in &publishers {
            publisher
                .publish(&pattern(16, seed))
                .unwrap()
                .complete()
                .unwrap();
        }
        if seed % 50 == 0 {
            // Lets all threads fall asleep.
            thread::sleep(Duration::from_millis(5));
        }
    }
    // Messages that wait for a window are sent when this node is called.
    for publisher in &publishers {
        assert!(publisher.flush_timeout(SOON).unwrap());
    }
    for reader in readers {
        reader.join().unwrap();
    }
}

/// A thread that drives the node may read the message that another thread waits for.
#[test]
fn a_thread_that_sleeps_is_woken_by_the_one_that_read_its_message() {
    let domain = Domain::new();
    let listener = domain.node("listener");
    let publisher = domain.node("talker").publisher::<[u8]>("topic").unwrap();
    let subscriber = listener.subscriber::<[u8]>("topic").unwrap();
    meet(&publisher, &[&subscriber]);
    let (got, seen) = mpsc::channel();
    let rounds = 300;
    let reader = thread::spawn(move || {
        for _ in 0..rounds {
            got.send(next(&subscriber).sequence()).unwrap();
        }
    });
    for round in 1..=rounds {
        if round % 3 == 0 {
            thread::sleep(Duration::from_micros(200));
        }
        publisher.publish(b"x").unwrap();
        let deadline = Instant::now() + SOON;
        let sequence = loop {
            // As fast as possible, so that this thread is always awake.
            listener.spin_some().unwrap();
            if let Ok(sequence) = seen.try_recv() {
                break sequence;
            }
            assert!(Instant::now() < deadline, "the reader was not woken");
        };
        assert_eq!(sequence, round);
    }
    reader.join().unwrap();
}

#[test]
fn a_descriptor_is_readable_while_there_may_be_a_message() {
    use std::os::fd::AsFd;
    let domain = Domain::new();
    let listener = domain.node("listener");
    let talker = domain.node("talker");
    let publisher = talker.publisher::<str>("a").unwrap();
    let subscriber = listener.subscriber::<str>("a").unwrap();
    meet(&publisher, &[&subscriber]);
    let readable = |timeout| sm2_io::wait_readable(&[subscriber.as_fd()], Some(timeout)).unwrap();
    // It may be readable more than once without a message, but not for ever.
    let quiet = || {
        until(|| {
            assert!(subscriber.try_recv().unwrap().is_none());
            !readable(Duration::ZERO)
        });
    };
    // At first the descriptor is readable, because no call has checked for messages yet.
    assert!(readable(SOON));
    quiet();
    publisher.publish("one").unwrap();
    assert!(readable(SOON));
    // Another call reads the message from the socket. It is still available to the subscriber.
    listener.spin_some().unwrap();
    assert!(readable(SOON));
    assert_eq!(&*subscriber.try_recv().unwrap().unwrap(), "one");
    quiet();
}
