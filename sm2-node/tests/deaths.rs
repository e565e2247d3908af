//! Subscribers that die: how much work one call of the publisher does for them. The nodes have no background thread, so
//! the calls of a test do all work.

use std::fs;
use std::time::Duration;

use sm2_node::{Publisher, Sample, Subscriber};
use sm2_test_support::ran_alone;

use crate::common::{Domain, Endpoint, LANES, SOON, meet, pattern, until};

/// How many bytes of segments this process has mapped for writing.
fn segment_bytes() -> usize {
    let maps = fs::read_to_string("/proc/self/maps").unwrap();
    let segments = maps.lines().filter(|it| it.contains("memfd:sm2-segment"));
    let writable = segments.filter(|it| it.contains(" rw-s "));
    let bytes = writable.map(|line| {
        let (start, rest) = line.split_once('-').unwrap();
        let (end, _) = rest.split_once(' ').unwrap();
        let [start, end] = [start, end].map(|it| usize::from_str_radix(it, 16).unwrap());
        end - start
    });
    bytes.sum()
}

/// A subscriber that holds 64 MiB goes. Its memory must not be used again, so it goes back to the system in parts.
#[test]
fn the_memory_that_a_dead_subscriber_held_goes_back_in_parts() {
    if ran_alone(concat!(
        module_path!(),
        "::the_memory_that_a_dead_subscriber_held_goes_back_in_parts"
    )) {
        return;
    }
    const MESSAGES: u16 = 32;
    const LEN_BYTES: usize = (2 << 20) - 4_096;
    const PART_BYTES: usize = 4 << 20;
    /// A call of `spin_once` drives the node before and after it waits.
    const PARTS_PER_CALL: usize = 2;
    let domain = Domain::new();
    let talker = domain.builder("talker").background(false);
    let talker = talker.connect().unwrap();
    let publisher = talker.publisher_builder::<[u8]>("topic");
    let publisher = publisher.pool_limit(1 << 30).declare().unwrap();
    let listener = domain.node("listener");
    let subscriber = listener.subscriber_builder::<[u8]>("topic");
    let subscriber: Subscriber<[u8]> = subscriber.max_borrowed(MESSAGES).declare().unwrap();
    meet(&publisher, &[&subscriber]);
    let held: Vec<Sample<[u8]>> = (0..u64::from(MESSAGES))
        .map(|seed| {
            publisher.publish(&pattern(LEN_BYTES, seed)).unwrap();
            subscriber.recv_timeout(SOON).unwrap().unwrap()
        })
        .collect();
    let all = segment_bytes();
    assert!(all >= usize::from(MESSAGES) * LEN_BYTES, "{all}");
    // The samples outlive the link, as the process of a subscriber may.
    drop((subscriber, listener));
    let mut before = all;
    until(|| {
        talker.spin_once_timeout(Duration::ZERO).unwrap();
        let after = segment_bytes();
        assert!(
            before - after <= PARTS_PER_CALL * PART_BYTES,
            "{before} to {after}"
        );
        before = after;
        before == 0
    });
    assert!(held.iter().all(|it| it.len() == LEN_BYTES));
}

/// Many links that end at once are ended by many calls.
#[test]
fn a_call_ends_few_links() {
    const LINKS: usize = 48;
    /// Each of the two sides of a node ends at most four links when it is driven.
    const ENDS_PER_DRIVE: usize = 8;
    for ring in LANES {
        // `publish` drives the node once, and once more if a message needs a socket; `links` drives it once.
        let drives = if ring { 2 } else { 3 };
        let mut domain = Domain::new();
        let talker = domain.builder("talker").background(false).ring_lane(ring);
        let publisher: Publisher<[u8]> = talker.connect().unwrap().publisher("topic").unwrap();
        let listener = domain.node_on(ring, "listener");
        let subscribers: Vec<Subscriber<[u8]>> = (0..LINKS)
            .map(|_| listener.subscriber("topic").unwrap())
            .collect();
        let ends: Vec<&dyn Endpoint> = subscribers.iter().map(|it| it as &dyn Endpoint).collect();
        meet(&publisher, &ends);
        // Without a Manager, the ends of the sockets alone tell the publisher.
        domain.stop();
        drop((subscribers, listener));
        let open = || publisher.links().iter().filter(|it| it.open).count();
        let mut before = LINKS;
        until(|| {
            let _ = publisher.publish(&[0]).unwrap();
            let after = open();
            assert!(
                before - after <= drives * ENDS_PER_DRIVE,
                "{before} to {after} with {drives} drives"
            );
            before = after;
            before == 0
        });
    }
}
