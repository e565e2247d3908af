//! Tests of the sleepers, beside the file, which loom's models include.

use std::sync::Arc;

use super::sleepers::{SPARES, Sleepers, SpareWakers};

#[test]
fn a_burst_of_sleepers_leaves_few_descriptors() {
    let spare = Arc::new(SpareWakers::new().unwrap());
    let mut sleepers = Sleepers::new(&spare);
    let enter = |_| sleepers.enter().unwrap();
    let wakers: Vec<_> = (0..SPARES + 3).map(enter).collect();
    wakers.iter().for_each(|it| sleepers.leave(it));
    assert_eq!((sleepers.count(), spare.count()), (0, SPARES));
}

#[test]
fn only_a_sleeper_that_sleeps_is_signalled() {
    let spare = Arc::new(SpareWakers::new().unwrap());
    let mut sleepers = Sleepers::new(&spare);
    let waker = sleepers.enter().unwrap();
    sleepers.attend(&waker);
    sleepers.wake();
    assert!(!sleepers.clear(&waker), "it looks by itself");
    sleepers.wake();
    sleepers.attend(&waker);
    assert!(sleepers.clear(&waker), "it was signalled before");
    sleepers.wake();
    assert!(sleepers.clear(&waker));
}
