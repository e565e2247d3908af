//! Tests of the sleepers, beside the file, which loom's models include.

use super::sleepers::{SPARES, Sleepers};

#[test]
fn a_burst_of_sleepers_leaves_few_descriptors() {
    let mut sleepers = Sleepers::default();
    let enter = |_| sleepers.enter().unwrap();
    let wakers: Vec<_> = (0..SPARES + 3).map(enter).collect();
    wakers.iter().for_each(|it| sleepers.leave(it));
    assert_eq!(sleepers.counts(), (0, SPARES));
}
