//! The pauses of a link.

use std::time::{Duration, Instant};

use crate::random::Random;

/// A kind of pause of a link. Items that would arrive during a pause arrive at its end, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pause {
    /// The duration of a pause.
    pub length: Duration,
    /// The mean time between two pauses; the actual time is random, from 0.5 to 1.5 times this.
    pub every: Duration,
}

/// The pauses of one link. They are the same in both directions, and depend only on the seed.
#[derive(Clone, Debug)]
pub(crate) struct Pauses(Vec<Series>);

/// All pauses of one length.
#[derive(Clone, Debug)]
struct Series {
    pause: Pause,
    /// The start of the current or next pause.
    begin: Instant,
    random: Random,
}

impl Pauses {
    /// The pauses after `epoch`.
    pub(crate) fn new(pauses: &[Pause], epoch: Instant, seed: u64) -> Self {
        // A pause without a length would make `Series::hold` loop forever.
        let real = pauses.iter().filter(|it| !it.length.is_zero());
        let series = (seed..).zip(real).map(|(seed, &pause)| {
            let mut random = Random::new(seed);
            let begin = epoch + pause.every.mul_f64(0.5 + random.part());
            Series {
                pause,
                begin,
                random,
            }
        });
        Self(series.collect())
    }

    /// The arrival time of an item that would arrive at `at` without pauses. `at` must not decrease
    /// from call to call.
    pub(crate) fn hold(&mut self, mut at: Instant) -> Instant {
        loop {
            // The end of a pause may be within a pause of another series.
            let held = self.0.iter_mut().fold(at, |at, series| series.hold(at));
            if held == at {
                return at;
            }
            at = held;
        }
    }
}

impl Series {
    fn hold(&mut self, at: Instant) -> Instant {
        loop {
            let end = self.begin + self.pause.length;
            if at < self.begin {
                return at;
            } else if at < end {
                return end;
            }
            self.begin = end + self.pause.every.mul_f64(0.5 + self.random.part());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHORT: Pause = Pause {
        length: Duration::from_millis(102),
        every: Duration::from_secs(5),
    };
    const LONG: Pause = Pause {
        length: Duration::from_millis(1_030),
        every: Duration::from_secs(30),
    };

    #[test]
    fn what_is_held_comes_in_order_and_no_later_than_all_pauses_together() {
        let epoch = Instant::now();
        let mut pauses = Pauses::new(&[SHORT, LONG], epoch, 1);
        let (mut last, mut ends) = (epoch, Vec::new());
        for millis in 0..600_000 {
            let at = epoch + Duration::from_millis(millis);
            let held = pauses.hold(at.max(last));
            assert!(held >= at && held >= last);
            assert!(held - at <= SHORT.length + LONG.length);
            if held > at && held > last {
                ends.push(held);
            }
            last = held;
        }
        // In ten minutes there are about 118 short and 19 long pauses, and some of them overlap.
        assert!((90..180).contains(&ends.len()), "{}", ends.len());
    }

    #[test]
    fn both_ways_stand_still_at_the_same_time() {
        let epoch = Instant::now();
        let [mut busy, mut idle] = [7, 7].map(|seed| Pauses::new(&[SHORT, LONG], epoch, seed));
        let mut last = epoch;
        for millis in 0..100_000 {
            let at = (epoch + Duration::from_millis(millis)).max(last);
            last = busy.hold(at);
            // The traffic of one direction does not affect the pauses of the other one.
            if millis % 97 == 0 {
                assert_eq!(idle.hold(at), last, "after {millis} ms");
            }
        }
    }

    #[test]
    fn a_pause_holds_from_its_first_moment_to_its_end() {
        const COUNT: u32 = 1_000;
        let epoch = Instant::now();
        let [moment, mut total] = [1, 0].map(Duration::from_nanos);
        let Pauses(mut series) = Pauses::new(&[SHORT], epoch, 1);
        let series = &mut series[0];
        let mut last = epoch;
        for _ in 0..COUNT {
            let (begin, end) = (series.begin, series.begin + SHORT.length);
            let between = begin - last;
            assert!(between >= SHORT.every / 2 && between < SHORT.every * 3 / 2);
            total += between;
            assert_eq!(series.hold(begin - moment), begin - moment);
            assert_eq!(series.hold(begin), end);
            assert_eq!(series.hold(end - moment), end);
            assert_eq!(series.hold(end), end);
            assert_ne!(series.begin, begin, "the next pause");
            last = end;
        }
        let mean = total / COUNT;
        assert!(mean > SHORT.every * 19 / 20 && mean < SHORT.every * 21 / 20);
    }

    #[test]
    fn without_pauses_nothing_is_held() {
        let epoch = Instant::now();
        let none = Pause {
            length: Duration::ZERO,
            every: Duration::ZERO,
        };
        for pauses in [&[][..], &[none]] {
            assert_eq!(Pauses::new(pauses, epoch, 1).hold(epoch), epoch);
        }
    }
}
