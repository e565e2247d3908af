//! Measures one step of a cycle in wall time, without the steps before and after it.

use std::time::{Duration, Instant};

use criterion::Bencher;

/// Measures `step`. Each turn runs `before`, `step` and `after` `turn` times each, so that the
/// clock is read twice per turn and not twice per step.
pub fn in_turns<S, R>(
    bencher: &mut Bencher<'_>,
    turn: u64,
    state: &mut S,
    before: impl Fn(&mut S),
    step: impl Fn(&mut S) -> R,
    after: impl Fn(&mut S),
) {
    bencher.iter_custom(|iterations| {
        let mut spent = Duration::ZERO;
        let mut left = iterations;
        while left > 0 {
            let steps = left.min(turn);
            (0..steps).for_each(|_| before(state));
            let start = Instant::now();
            for _ in 0..steps {
                std::hint::black_box(step(state));
            }
            spent += start.elapsed();
            (0..steps).for_each(|_| after(state));
            left -= steps;
        }
        spent
    });
}
