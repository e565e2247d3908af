//! Domain time: the time that the programs of a domain share in a simulation or a replay (SPEC section 16.1).
//!
//! A reading of domain time is not a tick: it states the domain time of a moment and its speed (SM2-CLK-002). A source
//! publishes a reading when it starts, pauses, jumps or changes its speed, so timers between two readings are exact.
//! The topic is latched, so a node that comes later gets the newest reading. A simulator that advances time in steps
//! publishes readings of speed 0.

use core::time::Duration;

use crate::Instant;

/// A moment of domain time, in nanoseconds since 1970-01-01 00:00 UTC.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct DomainTime(pub u64);

impl DomainTime {
    /// The time from `earlier` to this moment; zero if `earlier` is later.
    #[must_use]
    pub fn since(self, earlier: Self) -> Duration {
        Duration::from_nanos(self.0.saturating_sub(earlier.0))
    }
}

/// The relation of domain time to the monotonic clock, as its source publishes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ClockReading {
    /// The domain time at the moment `at`.
    pub time: DomainTime,
    /// A moment of the monotonic clock.
    pub at: Instant,
    /// By how many nanoseconds domain time advances in a second; 0 if it stands still.
    pub ns_per_s: u64,
}

const SECOND_NS: u128 = 1_000_000_000;

impl ClockReading {
    /// The domain time at a moment of the monotonic clock.
    //= SM2-CLK-002
    #[must_use]
    pub fn time(self, now: Instant) -> DomainTime {
        let passed_ns = u128::from(now.0.saturating_sub(self.at.0));
        let advanced_ns = passed_ns * u128::from(self.ns_per_s) / SECOND_NS;
        let time_ns = u128::from(self.time.0).saturating_add(advanced_ns);
        DomainTime(u64::try_from(time_ns).unwrap_or(u64::MAX))
    }

    /// The first moment of the monotonic clock when domain time has reached `time`. `None` if it does not reach
    /// `time` by this reading, or only beyond the range of the clock.
    #[must_use]
    pub fn instant(self, time: DomainTime) -> Option<Instant> {
        let ahead_ns = u128::from(time.0.saturating_sub(self.time.0));
        if ahead_ns == 0 {
            return Some(Instant(0));
        }
        let rate = u128::from(self.ns_per_s);
        let wait_ns = (ahead_ns * SECOND_NS).checked_add(rate.checked_sub(1)?)? / rate;
        let at_ns = u128::from(self.at.0).checked_add(wait_ns)?;
        u64::try_from(at_ns).ok().map(Instant)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn reading(time_ns: u64, at_ns: u64, ns_per_s: u64) -> ClockReading {
        ClockReading {
            time: DomainTime(time_ns),
            at: Instant(at_ns),
            ns_per_s,
        }
    }

    //= SM2-CLK-002 test
    #[test]
    fn domain_time_follows_the_reading() {
        let half = reading(1_000, 500, 500_000_000);
        for (now, expected) in [
            (0, 1_000),
            (500, 1_000),
            (501, 1_000),
            (502, 1_001),
            (700, 1_100),
        ] {
            assert_eq!(half.time(Instant(now)), DomainTime(expected), "at {now}");
        }
        let paused = reading(1_000, 500, 0);
        assert_eq!(paused.time(Instant(u64::MAX)), DomainTime(1_000));
        assert_eq!(paused.instant(DomainTime(1_001)), None);
        assert_eq!(paused.instant(DomainTime(1_000)), Some(Instant(0)));
        let fast = reading(1, 0, u64::MAX);
        assert_eq!(fast.time(Instant(u64::MAX)), DomainTime(u64::MAX));
    }

    proptest! {
        #[test]
        fn the_instant_of_a_time_is_the_first_one_that_reaches_it(
            time in any::<u64>(), at in any::<u64>(),
            rate in prop_oneof![0..5_000_000_000_u64, any::<u64>()],
            ahead in prop_oneof![0..10_000_u64, any::<u64>()],
        ) {
            let reading = reading(time, at, rate);
            let wanted = DomainTime(time.saturating_add(ahead));
            match reading.instant(wanted) {
                Some(instant) => {
                    prop_assert!(reading.time(instant) >= wanted);
                    if let Some(before) = instant.0.checked_sub(1) {
                        prop_assert!(reading.time(Instant(before)) < wanted);
                    }
                }
                None => prop_assert!(reading.time(Instant(u64::MAX)) < wanted),
            }
        }
    }
}
