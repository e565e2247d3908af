//! How many incidents triggers may begin.

use std::time::Duration;

/// So many incidents may begin one after the other.
pub(super) const BURST: u64 = 8;

/// A limit for incidents, which every process of the domain can begin by a call: `BURST` of them at once, and one more
/// in each period. Then the disk gets no more than a few times what is published.
pub(super) struct Limit {
    period_ns: u64,
    /// The time when all incidents of a burst may begin again, in nanoseconds of the wall clock.
    full_ns: u64,
}

impl Limit {
    pub(super) fn new(period: Duration) -> Self {
        Self {
            period_ns: u64::try_from(period.as_nanos()).unwrap_or(u64::MAX),
            full_ns: 0,
        }
    }

    /// Whether an incident may begin now. Then it counts.
    pub(super) fn admits(&mut self, now_ns: u64) -> bool {
        let full_ns = self.full_ns.max(now_ns).saturating_add(self.period_ns);
        let admits = full_ns - now_ns <= self.period_ns.saturating_mul(BURST);
        if admits {
            self.full_ns = full_ns;
        }
        admits
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_burst_is_followed_by_one_in_each_period() {
        let mut limit = Limit::new(Duration::from_nanos(10));
        let mut admitted = |now_ns| (0..100).filter(|_| limit.admits(now_ns)).count() as u64;
        assert_eq!(admitted(1_000), BURST);
        assert_eq!(admitted(1_009), 0);
        assert_eq!(admitted(1_010), 1);
        assert_eq!(admitted(1_035), 2);
        assert_eq!(admitted(9_000), BURST);
    }
}
