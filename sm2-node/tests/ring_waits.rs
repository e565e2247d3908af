//! No thread misses the event that it waits for, in any way of waiting and on both lanes: a message, room, or
//! the end of the peer that would have made room.

use crate::common;
use std::os::fd::AsFd;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::{Duration, Instant};

use crate::common::{Domain, LANES, SOON, WAYS, next, number_in_slot};
use sm2_io::wait_readable;
use sm2_node::asynchronous::IntoAsync;
use sm2_node::{Published, Publisher, Sample, Subscriber, Wait};

/// Longer than any test takes: a thread that waits so long was not woken.
const EVER: Duration = Duration::from_secs(3_600);

fn subscriber(domain: &Domain, ring: bool, way: Wait) -> Subscriber<[u64]> {
    let builder = domain.node_on(ring, "listener").subscriber_builder("topic");
    builder.wait(way).declare().unwrap()
}

/// Publishes a number: an odd one in a slot, and an even one in a cell of the ring.
fn publish(publisher: &Publisher<[u64]>, number: u64) -> Published {
    let published = match number % 2 {
        0 => publisher.publish(&[number]),
        _ => publisher.publish(&number_in_slot(number)),
    };
    published.unwrap()
}

/// Pauses for a duration that differs from round to round, so that the other thread is met before it waits,
/// while it is about to wait, and while it waits.
fn dawdle(round: u64) {
    let spins = [0, 10, 100, 1_000, 10_000][(round % 5) as usize];
    (0..spins * (1 + round % 3)).for_each(|_| std::hint::spin_loop());
}

/// Publishes numbers from 1 on, each as soon as the previous one was acknowledged.
fn talker(domain: &Domain, ring: bool, rounds: u64) -> (Arc<AtomicU64>, thread::JoinHandle<()>) {
    let publisher = domain.node_on(ring, "talker").publisher::<[u64]>("topic");
    let publisher: Publisher<[u64]> = publisher.unwrap();
    let taken = Arc::new(AtomicU64::new(0));
    let acknowledged = Arc::clone(&taken);
    let thread = thread::spawn(move || {
        publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
        for number in 1..=rounds {
            let late = Instant::now() + SOON;
            while acknowledged.load(Ordering::Acquire) < number - 1 {
                assert!(Instant::now() < late, "message {number} was not taken");
                thread::yield_now();
            }
            dawdle(number);
            assert_eq!(publish(&publisher, number).links, 1);
        }
        assert!(publisher.flush_timeout(SOON).unwrap());
    });
    (taken, thread)
}

/// Takes the numbers that a [`talker`] publishes.
fn take_all(rounds: u64, taken: &AtomicU64, mut next: impl FnMut(u64) -> Sample<[u64]>) {
    for number in 1..=rounds {
        let sample = next(number);
        assert_eq!((sample[0], sample.lost()), (number, 0));
        taken.store(number, Ordering::Release);
        dawdle(number / 2);
    }
}

//= SM2-RNG-012 test
#[test]
fn each_way_of_waiting_gets_what_comes() {
    const ROUNDS: u64 = if cfg!(feature = "slow") { 400 } else { 100 };
    for ring in LANES {
        for way in WAYS {
            let domain = Domain::new();
            let subscriber = subscriber(&domain, ring, way);
            let (taken, talker) = talker(&domain, ring, ROUNDS);
            subscriber.wait_for_publishers_timeout(1, SOON).unwrap();
            take_all(ROUNDS, &taken, |number| match number % 2 {
                0 => subscriber.recv().unwrap(),
                _ => next(&subscriber),
            });
            talker.join().unwrap();
        }
    }
}

#[test]
fn whoever_waits_for_a_time_waits_no_longer() {
    let time = Duration::from_millis(10);
    for ring in LANES {
        for way in WAYS {
            let domain = Domain::new();
            let subscriber = subscriber(&domain, ring, way);
            let publisher = domain.node_on(ring, "talker").publisher::<[u64]>("topic");
            let publisher = publisher.unwrap();
            // Without a link, and with one.
            for links in [0, 1] {
                if links > 0 {
                    common::meet(&publisher, &[&subscriber]);
                }
                for time in [Duration::ZERO, time] {
                    let start = Instant::now();
                    assert!(subscriber.recv_timeout(time).unwrap().is_none());
                    assert!(start.elapsed() >= time, "{way:?}");
                }
            }
            publish(&publisher, 7);
            assert_eq!(next(&subscriber)[0], 7);
        }
    }
}

/// A program polls the descriptor whenever it finds nothing: each message must make it readable.
//= SM2-RNG-012 test
#[test]
fn a_polled_descriptor_is_readable_for_every_message() {
    const ROUNDS: u64 = if cfg!(feature = "slow") { 1_000 } else { 200 };
    for ring in LANES {
        let domain = Domain::new();
        let subscriber = subscriber(&domain, ring, Wait::Park);
        let (taken, talker) = talker(&domain, ring, ROUNDS);
        take_all(ROUNDS, &taken, |number| {
            loop {
                if let Some(sample) = subscriber.try_recv().unwrap() {
                    return sample;
                }
                let woken = wait_readable(&[subscriber.as_fd()], Some(SOON)).unwrap();
                assert!(woken, "no wake-up for message {number}");
            }
        });
        talker.join().unwrap();
    }
}

/// The same with `try_recv_many`, for a loop that polls.
#[test]
fn a_polled_descriptor_is_readable_for_who_takes_many() {
    const ROUNDS: u64 = if cfg!(feature = "slow") { 500 } else { 100 };
    for ring in LANES {
        let domain = Domain::new();
        let subscriber = subscriber(&domain, ring, Wait::Park);
        let (taken, talker) = talker(&domain, ring, ROUNDS);
        let mut samples = Vec::new();
        take_all(ROUNDS, &taken, |number| {
            while subscriber.try_recv_many(&mut samples, 4).unwrap() == 0 {
                let woken = wait_readable(&[subscriber.as_fd()], Some(SOON)).unwrap();
                assert!(woken, "no wake-up for message {number}");
            }
            samples.pop().unwrap()
        });
        talker.join().unwrap();
    }
}

#[test]
fn a_future_is_woken_for_every_message() {
    const ROUNDS: u64 = if cfg!(feature = "slow") { 500 } else { 100 };
    for ring in LANES {
        let domain = Domain::new();
        let subscriber = subscriber(&domain, ring, Wait::Park);
        let (taken, talker) = talker(&domain, ring, ROUNDS);
        let runtime = tokio::runtime::Builder::new_current_thread();
        let runtime = { runtime }.enable_all().build().unwrap();
        let subscriber = {
            let _inside = runtime.enter();
            subscriber.into_async().unwrap()
        };
        take_all(ROUNDS, &taken, |number| {
            let timed = async { tokio::time::timeout(SOON, subscriber.recv()).await };
            let received = runtime.block_on(timed);
            let received = received.unwrap_or_else(|_| panic!("message {number} did not wake it"));
            received.unwrap()
        });
        talker.join().unwrap();
    }
}

/// A reliable publisher with its own thread. It publishes messages to a subscriber with room for one, and
/// reports the result of each.
fn patient(
    domain: &Domain,
    ring: bool,
    rounds: u64,
) -> (
    Subscriber<[u64]>,
    Receiver<Published>,
    thread::JoinHandle<()>,
) {
    let builder = domain
        .node_on(ring, "talker")
        .publisher_builder::<[u64]>("topic");
    let publisher = builder
        .depth(1)
        .reliable(true)
        .publish_timeout(EVER)
        .declare()
        .unwrap();
    let builder = domain.node_on(ring, "listener").subscriber_builder("topic");
    let builder = builder.depth(1).max_borrowed(1).reliable(true);
    let subscriber = builder.declare().unwrap();
    let (sender, published) = channel();
    let thread = thread::spawn(move || {
        publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
        for number in 1..=rounds {
            dawdle(number / 7);
            sender.send(publish(&publisher, number)).unwrap();
        }
        // Messages that wait on this side would be lost when the publisher is dropped.
        assert!(publisher.flush_timeout(SOON).unwrap());
    });
    (subscriber, published, thread)
}

//= SM2-QOS-002 test
//= SM2-RNG-012 test
#[test]
fn a_publisher_that_waits_for_room_is_woken_by_who_makes_some() {
    const ROUNDS: u64 = if cfg!(feature = "slow") { 1_000 } else { 200 };
    for ring in LANES {
        let domain = Domain::new();
        let (subscriber, published, thread) = patient(&domain, ring, ROUNDS);
        for number in 1..=ROUNDS {
            let sample = next(&subscriber);
            assert_eq!((sample[0], sample.lost()), (number, 0));
            dawdle(number);
            drop(sample);
            // After it has released its messages, the subscriber need not read its sockets again.
            dawdle(number / 3);
        }
        for _ in 0..ROUNDS {
            let published = published.recv_timeout(SOON).unwrap();
            assert_eq!((published.links, published.missed), (1, 0));
        }
        thread.join().unwrap();
    }
}

//= SM2-QOS-002 test
#[test]
fn a_publisher_that_waits_for_room_is_woken_when_nobody_is_left() {
    for ring in LANES {
        for round in 0..20 {
            let domain = Domain::new();
            let (subscriber, published, thread) = patient(&domain, ring, 20);
            // More messages than there is room for: from here on the publisher waits, or is about to.
            let sample = next(&subscriber);
            while ring && subscriber.links()[0].ring && published.try_recv().is_err() {
                thread::yield_now();
            }
            dawdle(round);
            match round % 2 {
                0 => drop(sample),
                _ => std::mem::forget(sample),
            }
            drop(subscriber);
            thread.join().unwrap();
        }
    }
}
