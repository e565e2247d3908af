//! Waits before attempts to connect.

// Shows CLI-BACKOFF (test), bound: sampled seeds.

use std::{collections::BTreeSet, time::Duration};

use sm2_proto::Backoff;

const MOST: Duration = Duration::from_millis(250);

//= SM2-RES-001 test
#[test]
fn waits_double_up_to_the_longest_and_differ() {
    let limits = [10, 20, 40, 80, 160, 250, 250, 250].map(Duration::from_millis);
    let mut seen = BTreeSet::new();
    for seed in 0..500 {
        let mut backoff = Backoff::new(seed, MOST);
        for round in 0..2 {
            for (at, limit) in limits.into_iter().enumerate() {
                let wait = backoff.wait();
                assert!(wait <= limit, "{wait:?} of {limit:?}");
                assert!(at == 0 || wait >= limit / 2, "{wait:?} of {limit:?}");
                seen.insert(wait);
            }
            assert!(round == 0 || seen.len() > limits.len());
            // A connection without a duration changes nothing.
            backoff.ended_after(MOST - Duration::from_nanos(1));
            assert!(backoff.wait() >= MOST / 2);
            backoff.ended_after(MOST);
        }
    }
    assert!(seen.len() > 7_000, "{} of 8,000 waits differ", seen.len());
    let first = |seed| Backoff::new(seed, MOST).wait();
    let half = Duration::from_millis(5);
    assert!((0..100).any(|seed| first(seed) < half));
    assert!((0..100).any(|seed| first(seed) > half));
}
