//! Wall time of one step of a cycle: what has to happen before and after it is not measured.

use std::time::{Duration, Instant};

use criterion::Bencher;

/// Measures `step`. In each turn `before` runs `turn` times, then `step`, then `after`, as
/// often each: so the clock is read twice for so many steps, not for each one.
pub(crate) fn in_turns<S, R>(
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
