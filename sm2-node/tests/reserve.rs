//! Memory that is reserved for messages.

use crate::common;
use crate::common::{Domain, meet, next, pattern};
use sm2_node::{DeclareError, Publisher, PublisherBuilder, StoreError};

type Change = fn(PublisherBuilder<[u8]>) -> PublisherBuilder<[u8]>;

fn declared(domain: &Domain, change: Change) -> Result<Publisher<[u8]>, DeclareError> {
    let node = domain.node("talker");
    change(node.publisher_builder("topic")).declare()
}

#[test]
fn what_cannot_be_reserved() {
    let domain = Domain::new();
    let without: [Change; 3] = [
        |it| it.prefault(true),
        |it| it.mlock(true),
        |builder| builder.slots(3),
    ];
    for change in without {
        let error = declared(&domain, change).unwrap_err();
        assert!(matches!(error, DeclareError::NoMaxLen { .. }), "{error}");
        assert!(error.to_string().contains("max_len"), "{error}");
    }
    let error = declared(&domain, |it| it.sealed(true).max_len(9)).unwrap_err();
    assert!(
        matches!(error, DeclareError::ReservedSealed { .. }),
        "{error}"
    );
    let too_much: [Change; 3] = [
        |it| it.max_len(usize::MAX),
        |it| it.max_len(1 << 40).slots(2),
        |it| it.max_len(1).slots(65_537),
    ];
    for change in too_much {
        let error = declared(&domain, change).unwrap_err();
        assert!(
            matches!(error, DeclareError::ReserveTooMuch { .. }),
            "{error}"
        );
    }
    // None of the failed declarations left anything, and the Manager saw none of them.
    assert_eq!(
        domain
            .node("watcher")
            .snapshot()
            .unwrap()
            .interfaces()
            .count(),
        0
    );
}

#[test]
fn as_many_slots_as_were_reserved_and_no_more_than_allowed() {
    let domain = Domain::new();
    let publisher = declared(&domain, |it| {
        it.max_len(1_000_000).slots(3).pool_limit(0).latched(2)
    });
    let publisher = publisher.unwrap();
    let bytes = publisher.pool_bytes();
    assert_eq!(bytes, 3 << 20);
    // Two messages are latched for later subscribers, and one slot is being written.
    for seed in 1..=9 {
        publisher.publish(&pattern(1_000_000, seed)).unwrap();
    }
    let loan = publisher.loan_slice(1_000_000).unwrap();
    let error = publisher
        .publish(&pattern(600_000, 0))
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("3145728 bytes") && error.contains("slots"),
        "{error}"
    );
    drop(loan);
    let too_long = publisher.loan_slice(2_000_000).unwrap_err();
    assert!(
        matches!(too_long, StoreError::PoolFull { .. }),
        "{too_long}"
    );
    let subscriber = domain.node("late").subscriber::<[u8]>("topic").unwrap();
    meet(&publisher, &[&subscriber]);
    for seed in 8..=9 {
        assert!(*next(&subscriber) == *pattern(1_000_000, seed));
    }
    assert_eq!(publisher.pool_bytes(), bytes);
}

#[test]
fn more_than_was_reserved_is_found_where_it_is_allowed() {
    let domain = Domain::new();
    let publisher = declared(&domain, |it| it.max_len(10_000).slots(1).prefault(true)).unwrap();
    let bytes = publisher.pool_bytes();
    assert_eq!(bytes, 12 << 10);
    let first = publisher.loan_slice(10_000).unwrap();
    let second = publisher.loan_slice(10_000).unwrap();
    let long = publisher.loan_slice(100_000).unwrap();
    assert!(publisher.pool_bytes() > bytes);
    drop((first, second, long));
}

/// A process that is killed while it holds a sample costs one slot, not all of them.
#[test]
fn slots_that_are_lost_are_made_up_for() {
    let domain = Domain::new();
    let publisher = declared(&domain, |it| {
        it.max_len(100_000).slots(2).prefault(true).pool_limit(0)
    });
    let publisher = publisher.unwrap();
    for round in 0..5 {
        let listener = domain.node("listener");
        let subscriber = listener.subscriber::<[u8]>("topic").unwrap();
        meet(&publisher, &[&subscriber]);
        publisher.publish(&pattern(100_000, round)).unwrap();
        let sample = next(&subscriber);
        drop(subscriber);
        let gone = || publisher.links().iter().all(|link| !link.open);
        common::until(gone);
        // A process that still reads the sample sees it unchanged.
        for _ in 0..3 {
            let mut loans = [(); 2].map(|()| publisher.loan_slice(100_000).unwrap());
            loans.iter_mut().for_each(|loan| loan.fill(1));
            assert!(publisher.loan_slice(100_000).is_err(), "two, and no more");
        }
        assert!(*sample == *pattern(100_000, round), "round {round}");
        drop((sample, listener));
        common::until(|| domain.node("watcher").snapshot().unwrap().nodes().count() == 2);
    }
}
