//! No descriptor and no mapping stays behind. In its own file: the test counts those of the whole process.

// Shows DAT-NOLEAK (test), bound: one process.

use sm2_test_support::ran_alone;
use std::time::Duration;

use crate::common::{Domain, SOON, pattern};
use sm2_node::{Publisher, Subscriber};

/// Each of the six orders is used.
const ROUNDS: u64 = if cfg!(feature = "slow") { 20 } else { 6 };

fn descriptors() -> usize {
    std::fs::read_dir("/proc/self/fd").unwrap().count()
}

fn shared_mappings() -> usize {
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
    maps.lines()
        .filter(|line| line.contains("memfd:sm2"))
        .count()
}

//= SM2-OPN-009 test
#[test]
fn no_descriptor_and_no_mapping_stays_behind() {
    if ran_alone(concat!(
        module_path!(),
        "::no_descriptor_and_no_mapping_stays_behind"
    )) {
        return;
    }
    let domain = Domain::new();
    let before = (descriptors(), shared_mappings());
    for round in 0..ROUNDS {
        cycle(&domain, round);
        // The Manager, which is in this process too, closes its ends a little later.
        let what = format!("the descriptors and mappings of round {round} are gone: {before:?}");
        sm2_test_support::until(&what, || (descriptors(), shared_mappings()) == before);
    }
}

/// Uses every form and every kind of end, in an order that differs from round to round.
fn cycle(domain: &Domain, round: u64) {
    let talker = domain.node("talker");
    let listener = domain.node("listener");
    let publisher = talker
        .publisher_builder::<[u8]>("topic")
        .latched(2)
        .declare()
        .unwrap();
    let sealed = round.is_multiple_of(2);
    let builder = listener.subscriber_builder::<[u8]>("topic").sealed(sealed);
    let subscriber = builder.declare().unwrap();
    meet(&publisher, &subscriber);
    for size in [10, 5000, 100_000, 3 << 20, 5000] {
        publisher.publish(&pattern(size, round)).unwrap();
    }
    let loan = publisher.loan_slice(200_000).unwrap();
    let samples: Vec<_> = (0..3)
        .map(|_| subscriber.recv_timeout(SOON).unwrap())
        .collect();
    if round.is_multiple_of(3) {
        drop(samples);
        drop((subscriber, loan));
        drop((publisher, listener));
    } else {
        drop(loan);
        drop(publisher);
        drop((listener, subscriber));
        drop(samples);
    }
    drop(talker);
    wait_until_gone(domain);
}

fn meet(publisher: &Publisher<[u8]>, subscriber: &Subscriber<[u8]>) {
    let step = Duration::from_millis(1);
    while publisher.wait_for_subscribers_timeout(1, step).is_err() {
        let _ = subscriber.wait_for_publishers_timeout(1, step);
    }
}

/// Waits until the Manager knows that the nodes are gone, and their names are free.
fn wait_until_gone(domain: &Domain) {
    let watcher = domain.node("watcher");
    while watcher.snapshot().unwrap().nodes().count() > 1 {
        std::thread::sleep(Duration::from_millis(1));
    }
    drop(watcher);
    while domain.builder("watcher").connect().is_err() {}
}
