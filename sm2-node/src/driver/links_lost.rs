//! Limits the warnings about links whose sockets this process could not receive. While descriptors
//! are missing, the Manager tries again about once a second for each of these links.

use std::time::Duration;

use sm2_proto::Instant;

/// The time between two warnings.
const PERIOD: Duration = Duration::from_secs(10);

/// The links that were lost since the last warning.
#[derive(Debug, Default)]
pub(super) struct LinksLost {
    count: u64,
    /// The time from which on the next warning may be written.
    next: Instant,
}

impl LinksLost {
    /// Counts a link. Returns the number of links since the last warning if a warning is due.
    pub(super) fn note(&mut self, now: Instant) -> Option<u64> {
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
    fn one_warning_in_ten_seconds_counts_all_links() {
        let mut lost = LinksLost::default();
        let second = |at: u64| Instant(at * 1_000_000_000);
        assert_eq!(lost.note(second(1)), Some(1));
        for _ in 0..100 {
            assert_eq!(lost.note(second(10)), None);
        }
        assert_eq!(lost.note(second(11)), Some(101));
        assert_eq!(lost.note(second(20)), None);
    }
}
