//! Publishing with a reserved pool does not allocate, and neither does waiting in a set. In its own file: the tests
//! count the allocations of their threads.

mod common;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use common::{Domain, meet, until};
use sm2_node::{Node, Publisher, Shutdown, Subscriber, Timer, WaitSet};

struct Counting;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: every call is passed on to the system allocator; counting changes nothing about it.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: the caller's promise about `layout` is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
        // SAFETY: the caller's promise about `at` and `layout` is passed on.
        unsafe { System.dealloc(at, layout) }
    }

    unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        ALLOCATIONS.set(ALLOCATIONS.get() + 1);
        // SAFETY: the caller's promise about `at`, `layout` and `size` is passed on.
        unsafe { System.realloc(at, layout, size) }
    }
}

#[global_allocator]
static COUNTING: Counting = Counting;

fn allocations(work: impl FnOnce()) -> usize {
    let before = ALLOCATIONS.get();
    work();
    ALLOCATIONS.get() - before
}

const LEN: usize = 100_000;
/// Each subscriber may hold 4, and 8 may wait for each; one is being written; the rest is spare.
const SLOTS: u32 = 32;

fn reserved(node: &Node) -> Publisher<[u8]> {
    let builder = node.publisher_builder::<[u8]>("topic");
    let builder = builder
        .max_len(LEN)
        .slots(SLOTS)
        .pool_limit(0)
        .prefault(true);
    builder.declare().unwrap()
}

/// Publishes in every way, also short messages.
fn publish(publisher: &Publisher<[u8]>, message: &[u8]) {
    for len in [1, 200, 4_000, LEN] {
        publisher.publish(&message[..len]).unwrap();
        let mut loan = publisher.loan_slice(len).unwrap();
        loan.copy_from_slice(&message[..len]);
        loan.publish().unwrap();
        drop(publisher.loan_slice(len).unwrap());
    }
}

/// How many messages [`publish`] sends.
const MESSAGES: usize = 8;

fn subscribe(domain: &Domain, name: &str) -> Subscriber<[u8]> {
    let node = domain.node(name);
    let builder = node.subscriber_builder::<[u8]>("topic");
    // A link allocates once for its records of up to eleven messages in flight.
    builder.depth(8).max_borrowed(2).declare().unwrap()
}

fn in_flight(publisher: &Publisher<[u8]>) -> u64 {
    (publisher.links().iter())
        .map(|link| link.counters.in_flight)
        .sum()
}

#[test]
fn publishing_does_not_allocate() {
    let domain = Domain::new();
    let publisher = reserved(&domain.node("talker"));
    let subscriber = subscribe(&domain, "listener");
    meet(&publisher, &[&subscriber]);
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    let reader = thread::spawn(move || {
        let mut count = 0;
        while !stopped.load(Ordering::Relaxed) {
            let sample = subscriber.recv_timeout(Duration::from_millis(1)).unwrap();
            count += usize::from(sample.is_some());
        }
        count
    });
    let message = vec![7; LEN];
    let room = publisher.pool_bytes();
    let mut count = 0;
    for round in 0..50 {
        let now = allocations(|| publish(&publisher, &message));
        // The first rounds make all allocations that happen only once.
        count += if round < 10 { 0 } else { now };
        until(|| in_flight(&publisher) == 0);
    }
    stop.store(true, Ordering::Relaxed);
    assert_eq!(reader.join().unwrap(), 50 * MESSAGES);
    assert_eq!(count, 0);
    assert_eq!(publisher.pool_bytes(), room);
    assert_eq!(allocations(|| drop(Box::new(1_u8))), 1, "counts at all");
}

/// A subscriber that does not take messages: the link allocates once for its records of waiting messages.
/// There are no other allocations.
#[test]
fn what_waits_for_a_subscriber_is_all_that_allocates() {
    const PER_MESSAGE: usize = 1;
    let domain = Domain::new();
    let publisher = reserved(&domain.node("talker"));
    let subscriber = subscribe(&domain, "stands-still");
    meet(&publisher, &[&subscriber]);
    let message = vec![7; LEN];
    (0..10).for_each(|_| publish(&publisher, &message));
    let count = allocations(|| (0..20).for_each(|_| publish(&publisher, &message)));
    assert!(count <= PER_MESSAGE * 20 * MESSAGES, "{count}");
}

/// How many bytes of the mapping that contains this address are in memory, and mapped.
fn resident(address: *const u8) -> usize {
    let maps = std::fs::read_to_string("/proc/self/smaps").unwrap();
    let mut inside = false;
    for line in maps.lines() {
        let (first, rest) = line.split_once(' ').unwrap_or((line, ""));
        if let Some((start, end)) = first.split_once('-')
            && let Ok(start) = usize::from_str_radix(start, 16)
            && let Ok(end) = usize::from_str_radix(end, 16)
        {
            inside = (start..end).contains(&address.addr());
        } else if inside && first == "Rss:" {
            let kibibytes = rest.trim().trim_end_matches(" kB");
            return kibibytes.parse::<usize>().unwrap() * 1024;
        }
    }
    panic!("no mapping at {address:?}");
}

/// Pages that are mapped need no page fault.
#[test]
fn what_is_prefaulted_is_mapped_before_it_is_written() {
    let domain = Domain::new();
    let publisher = reserved(&domain.node("talker"));
    let loan = publisher.loan_slice(LEN).unwrap();
    assert!(resident(loan.as_ptr()) >= SLOTS as usize * LEN);
    let without = domain.node("other").publisher_builder::<[u8]>("other");
    let without = without.max_len(LEN).slots(SLOTS).declare().unwrap();
    let loan = without.loan_slice(LEN).unwrap();
    assert!(resident(loan.as_ptr()) < SLOTS as usize * LEN / 2);
}

/// A wait, its message, and the ticks of a timer. (On the socket lane, reading the message allocates its bytes.)
#[test]
fn waiting_in_a_set_does_not_allocate() {
    let domain = Domain::new();
    let subscriber = domain.node_on(true, "listener").subscriber::<u64>("topic");
    let subscriber = subscriber.unwrap();
    let publisher = domain.node_on(true, "talker").publisher::<u64>("topic");
    let publisher = publisher.unwrap();
    meet(&publisher, &[&subscriber]);
    let shutdown = Shutdown::new().unwrap();
    let mut set = WaitSet::new().unwrap();
    set.add(&subscriber, true).unwrap();
    set.add_timer(Timer::every(Duration::from_micros(10)), false);
    set.end_with(&shutdown).unwrap();
    let mut round = |number: u64| {
        publisher.publish(&number).unwrap();
        let now = allocations(|| while !set.wait().unwrap().tag {});
        while subscriber.try_recv().unwrap().is_some() {}
        // The end of the messages, and ticks.
        now + allocations(|| (0..3).for_each(|_| assert!(set.wait().is_ok())))
    };
    // The first rounds make all allocations that happen only once.
    (0..50).map(&mut round).for_each(drop);
    assert_eq!((50..100).map(round).sum::<usize>(), 0);
}
