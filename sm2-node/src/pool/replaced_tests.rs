//! Segments that are replaced, because a process that may not read them any more may map them.

use super::tests::{marks, reserved, taken};
use super::*;

/// No slot of a replaced segment serves another message, neither a free one nor one that comes back.
//= SM2-ACC-015 test
#[test]
fn replaced_segments_serve_no_further_message() {
    let mut pool = Pool::new(1 << 20);
    let [held, other] = [(); 2].map(|()| taken(&mut pool, 1_000).unwrap());
    assert!(!pool.is_replaced(&held));
    assert!(pool.replace_all().is_empty());
    assert!(pool.is_replaced(&held) && pool.is_replaced(&other));
    let fresh = taken(&mut pool, 1_000).unwrap();
    assert_ne!(fresh.segment.id, held.segment.id);
    assert!(!pool.is_replaced(&fresh));
    let old = held.segment.id;
    assert_eq!(pool.give_back(held), None);
    assert_eq!(pool.abandon(other), Some(old), "the last of its slots");
    assert_eq!(pool.give_back(fresh), None);
    let unused = taken(&mut pool, 1_000).unwrap();
    assert_eq!(pool.give_back(unused), None);
    assert_eq!(pool.replace_all(), [1], "no slot is in use");
    assert_eq!((pool.bytes(), pool.used()), (0, 0));
}

#[test]
fn replaced_slots_that_were_reserved_are_made_up_for() {
    let mut pool = reserved(100_000, 3, 0);
    let [lost, held] = [(); 2].map(|()| pool.take(100_000, |_| ()).unwrap());
    assert_eq!(pool.abandon(lost), None);
    assert!(pool.replace_all().is_empty());
    let made_up = pool.plan(100_000).unwrap();
    assert_eq!((made_up.slots, made_up.reserved), (3, true));
    pool.add(made_up, marks(made_up));
    assert_eq!(pool.abandon(held), Some(0));
    assert!((0..3).all(|_| pool.take(100_000, |_| ()).is_some()));
    assert_eq!(pool.plan(100_000), Err(Full), "no more than was reserved");
}
