//! Limits warnings about events that may happen many times a second, such as a link whose socket this
//! process could not receive.

use std::time::Duration;

use sm2_proto::Instant;

/// The time between two warnings.
const PERIOD: Duration = Duration::from_secs(10);

/// The events since the last warning.
#[derive(Debug, Default)]
pub(super) struct LimitedWarning {
    count: u64,
    /// The earliest time for the next warning.
    next: Instant,
}

impl LimitedWarning {
    /// Counts an event. Returns the number of events since the last warning if a warning is due.
    pub(super) fn count(&mut self, now: Instant) -> Option<u64> {
        self.count += 1;
        if now < self.next {
            return None;
        }
        self.next = now.after(PERIOD);
        Some(std::mem::take(&mut self.count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_warning_in_ten_seconds_counts_all_events() {
        let mut limited = LimitedWarning::default();
        let second = |at: u64| Instant(at * 1_000_000_000);
        assert_eq!(limited.count(second(1)), Some(1));
        for _ in 0..100 {
            assert_eq!(limited.count(second(10)), None);
        }
        assert_eq!(limited.count(second(11)), Some(101));
        assert_eq!(limited.count(second(20)), None);
    }
}
