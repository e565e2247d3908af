//! The schedule of messages that are published at a fixed rate.

use std::time::Duration;

use sm2_proto::Instant;

/// When each message is due.
#[derive(Debug)]
pub(super) struct Pace {
    period: Duration,
    /// When the next message is due; `None` before the first.
    due: Option<Instant>,
}

impl Pace {
    /// A schedule of `hz` messages a second.
    pub(super) fn new(hz: f64) -> Self {
        Self {
            period: Duration::try_from_secs_f64(1.0 / hz).unwrap_or(Duration::MAX),
            due: None,
        }
    }

    /// Returns when the next message is due.
    ///
    /// A delay below one period is made up for, so that the rate stays exact. A longer one, such as a wait
    /// for a reliable subscriber, shifts the schedule: messages that follow each other without a pause
    /// would displace messages of the subscribers that are not reliable.
    pub(super) fn next(&mut self, now: Instant) -> Instant {
        let due = match self.due {
            Some(due) if now <= due.after(self.period) => due,
            _ => now,
        };
        self.due = Some(due.after(self.period));
        due
    }
}

#[cfg(test)]
mod tests {
    use sm2_proto::Instant;

    use super::Pace;

    const PERIOD: u64 = 100_000_000;

    #[test]
    fn a_short_delay_is_made_up_for() {
        let mut pace = Pace::new(10.0);
        assert_eq!(pace.next(Instant(5)), Instant(5));
        let late = Instant(5 + 2 * PERIOD);
        assert_eq!(pace.next(late), Instant(5 + PERIOD));
        assert_eq!(pace.next(late), Instant(5 + 2 * PERIOD));
        assert_eq!(pace.next(late), Instant(5 + 3 * PERIOD));
    }

    #[test]
    fn no_burst_follows_a_long_delay() {
        let mut pace = Pace::new(10.0);
        pace.next(Instant(0));
        let late = Instant(20 * PERIOD);
        assert_eq!(pace.next(late), late);
        assert_eq!(pace.next(late), Instant(21 * PERIOD));
    }
}
