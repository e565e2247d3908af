//! How often a program that waits for its conditions is reported.

use std::time::Duration;

use sm2_proto::Instant;

use super::limits::{FIRST_REMINDER, LONGEST_REMINDER, QUESTION_RETRY};
use crate::time::Span;

/// A program that waits for its conditions, which are reported from time to time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Waiting {
    since: Instant,
    /// When they are reported next.
    report_at: Instant,
    /// The time from that report to the one after it.
    interval: Duration,
    is_reported: bool,
}

impl Waiting {
    pub(super) const fn new(now: Instant) -> Self {
        Self {
            since: now,
            report_at: now,
            interval: FIRST_REMINDER,
            is_reported: false,
        }
    }

    /// When there may be a report although nothing happens.
    pub(super) const fn report_at(&self) -> Instant {
        self.report_at
    }

    /// The time since it began to wait, if a report is due now. The time to the next report is twice as long, except
    /// for the first two. `is_known`: whether the state of the domain is known.
    pub(super) fn report(&mut self, now: Instant, is_known: bool) -> Option<String> {
        if !self.is_reported {
            if !is_known {
                // The state comes within a moment, and wakes this process.
                self.report_at = now.after(QUESTION_RETRY);
                return None;
            }
        } else if now < self.report_at {
            return None;
        }
        self.report_at = now.after(self.interval);
        if !std::mem::replace(&mut self.is_reported, true) {
            return Some(String::new());
        }
        self.interval = (self.interval * 2).min(LONGEST_REMINDER);
        let seconds = now.since(self.since).as_secs();
        Some(format!(" for {}", Span(Duration::from_secs(seconds))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const START: Instant = Instant(5_000_000_000);

    fn at(seconds: u64) -> Instant {
        START.after(Duration::from_secs(seconds))
    }

    /// The seconds of the reports of a program that waits for an hour, and is looked at each second.
    #[test]
    fn the_reports_become_rare() {
        let mut waiting = Waiting::new(START);
        let mut reports = Vec::new();
        for seconds in 0..3_600 {
            // A state of the domain that is unknown again changes nothing.
            if let Some(text) = waiting.report(at(seconds), seconds != 20) {
                reports.push((seconds, text));
            }
            assert!(waiting.report_at() > at(seconds));
        }
        let seconds: Vec<_> = reports.iter().map(|it| it.0).collect();
        let expected = [0, 10, 20, 40, 80, 160, 320, 620, 920, 1_220];
        assert_eq!(seconds[..10], expected);
        assert_eq!(reports[0].1, "");
        assert_eq!(reports[3].1, " for 40 s");
    }

    /// A state of the domain that is not there yet is no news; one that does not come is.
    #[test]
    fn the_first_report_waits_for_the_state_of_the_domain() {
        let mut waiting = Waiting::new(START);
        for seconds in 0..3 {
            assert_eq!(waiting.report(at(seconds), false), None);
            assert_eq!(waiting.report_at(), at(seconds).after(QUESTION_RETRY));
        }
        assert_eq!(waiting.report(at(3), true).as_deref(), Some(""));
        assert_eq!(waiting.report(at(12), true), None);
        let text = waiting.report(at(13), false);
        assert_eq!(text.as_deref(), Some(" for 13 s"));
    }
}
