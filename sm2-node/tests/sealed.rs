//! A stream of sealed messages, and the memory that is prepared for them. In its own file: the test examines
//! all descriptors of its process.

use crate::common;
use sm2_test_support::ran_alone;
use std::time::Duration;

use crate::common::{Domain, meet, next, pattern};
use sm2_node::{Publisher, Subscriber};

/// Returns how many files of sealed messages this process has open.
fn files() -> usize {
    std::fs::read_dir("/proc/self/fd")
        .unwrap()
        .filter_map(|entry| std::fs::read_link(entry.unwrap().path()).ok())
        .filter(|to| to.to_string_lossy().contains("memfd:sm2-message"))
        .count()
}

/// Publishes this message as a copy or as a loan, and checks that it arrives.
fn send(publisher: &Publisher<[u8]>, subscriber: &Subscriber<[u8]>, message: &[u8], loan: bool) {
    let links = if loan {
        let mut loan = publisher.loan_slice(message.len()).unwrap();
        assert!(
            loan.iter().all(|&byte| byte == 0),
            "no byte of an earlier message is left"
        );
        loan.copy_from_slice(message);
        loan.publish().unwrap().links
    } else {
        publisher.publish(message).unwrap().links
    };
    assert_eq!(links, 1);
    assert!(*next(subscriber) == *message, "{} bytes", message.len());
}

#[test]
fn a_stream_of_sealed_messages_has_one_file_ready_and_a_single_one_none() {
    if ran_alone(concat!(
        module_path!(),
        "::a_stream_of_sealed_messages_has_one_file_ready_and_a_single_one_none"
    )) {
        return;
    }
    let domain = Domain::new();
    let lengths = [
        5_000, 5_001, 4_999, 100_000, 100_000, 140_000, 90_000, 600_000, 2_500_000, 2_400_000,
        5_000,
    ];
    for (idle, ready) in [(Duration::MAX, 1), (Duration::ZERO, 0)] {
        let talker = domain.node("talker");
        let builder = talker.publisher_builder::<[u8]>("topic").sealed(true);
        let publisher = builder.keep_idle(idle).declare().unwrap();
        let subscriber = domain.node("listener").subscriber("topic").unwrap();
        meet(&publisher, &[&subscriber]);
        for (seed, len) in (1..).zip(lengths.into_iter().cycle().take(33)) {
            send(&publisher, &subscriber, &pattern(len, seed), seed % 3 == 0);
        }
        // Reading the links makes the publisher notice the releases.
        common::until(|| publisher.links()[0].counters.in_flight == 0);
        assert_eq!(files(), ready);
        drop((publisher, subscriber));
        assert_eq!(files(), 0);
    }
}
