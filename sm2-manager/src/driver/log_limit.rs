//! Limits the warnings in the log, so that no node can fill it.

use std::{collections::BTreeMap, fmt, time::Duration};

use sm2_proto::{Code, Instant};

/// How many warnings of one kind are written in one period. The others are counted, and their number is written
/// when the period ends.
const WARNINGS: u32 = 16;
/// The length of a period, which begins with the first warning of its kind.
const PERIOD: Duration = Duration::from_secs(10);

/// The kinds of warnings that nodes can cause.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Warning {
    /// A session was ended with this code.
    HungUp(Code),
    /// No connection could be accepted.
    NotAccepted,
    /// An accepted connection cannot be served.
    NotServed,
    /// A socket cannot be read.
    NotRead,
    /// There was no memory to send a frame.
    NotSent,
    /// There was no free descriptor for one that came with a datagram.
    NotReceived,
    /// There was no socket pair for a link.
    NotLinked,
    /// Waiting for events failed.
    NotWaited,
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::HungUp(code) => write!(f, "hung up: {code}"),
            Self::NotAccepted => f.write_str("cannot accept a connection"),
            Self::NotServed => f.write_str("cannot serve a connection"),
            Self::NotRead => f.write_str("cannot read from a node"),
            Self::NotSent => f.write_str("no memory to send to a node"),
            Self::NotReceived => f.write_str("no free descriptor for a node's file"),
            Self::NotLinked => f.write_str("no socket pair for a link"),
            Self::NotWaited => f.write_str("cannot wait for events"),
        }
    }
}

/// The warnings of the current periods.
#[derive(Debug, Default)]
pub(super) struct LogLimit(BTreeMap<Warning, Period>);

#[derive(Debug)]
struct Period {
    since: Instant,
    written: u32,
    left_out: u64,
}

/// The warnings of one kind that were left out in a period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LeftOut {
    pub(super) warning: Warning,
    pub(super) count: u64,
    pub(super) seconds: u64,
}

impl LogLimit {
    /// Whether a warning may be written now. Counts it if not.
    pub(super) fn may_write(&mut self, warning: Warning, now: Instant) -> bool {
        let period = self.0.entry(warning).or_insert(Period {
            since: now,
            written: 0,
            left_out: 0,
        });
        if period.written < WARNINGS {
            period.written += 1;
            return true;
        }
        period.left_out += 1;
        false
    }

    /// The time of the next call of [`end_periods`](Self::end_periods).
    pub(super) fn deadline(&self) -> Option<Instant> {
        let ends = self.0.values().map(|it| it.since.after(PERIOD));
        ends.min()
    }

    /// Ends the periods that are over. Returns the warnings that were left out in them.
    pub(super) fn end_periods(&mut self, now: Instant) -> Vec<LeftOut> {
        let mut all = Vec::new();
        self.0.retain(|&warning, period| {
            let goes_on = now < period.since.after(PERIOD);
            if !goes_on && period.left_out > 0 {
                all.push(LeftOut {
                    warning,
                    count: period.left_out,
                    seconds: now.since(period.since).as_secs(),
                });
            }
            goes_on
        });
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: Duration = Duration::from_secs(1);

    #[test]
    fn a_flood_of_warnings_is_summed_up() {
        let mut log = LogLimit::default();
        let flood = Warning::HungUp(Code(9));
        let mut now = Instant(1);
        let written = (0..76_747).filter(|_| log.may_write(flood, now)).count();
        assert_eq!(written, 16);
        // Warnings of another kind are written.
        assert!(log.may_write(Warning::HungUp(Code(10)), now));
        assert!(log.may_write(Warning::NotRead, now));
        now = now.after(9 * SECOND);
        assert_eq!(log.end_periods(now), []);
        assert!(!log.may_write(flood, now));
        let end = log.deadline().expect("a period");
        now = end.after(SECOND);
        let sum = LeftOut {
            warning: flood,
            count: 76_747 - 16 + 1,
            seconds: 11,
        };
        assert_eq!(
            log.end_periods(now),
            [sum],
            "once, and only what was left out"
        );
        assert_eq!(log.deadline(), None, "nothing is kept");
        assert!(log.may_write(flood, now));
    }

    /// Otherwise the Manager would not sleep from the deadline on.
    #[test]
    fn a_period_is_over_at_its_deadline() {
        let mut log = LogLimit::default();
        let begin = Instant(1);
        for warning in [Warning::NotRead, Warning::NotSent] {
            let kept = (0..17).filter(|_| log.may_write(warning, begin)).count();
            assert_eq!(kept, 16, "{warning}");
        }
        // The period of a warning that was always written ends without a word.
        assert!(log.may_write(Warning::NotLinked, begin.after(SECOND)));
        let end = log.deadline().unwrap();
        assert_eq!(end, begin.after(10 * SECOND));
        let left_out = [Warning::NotRead, Warning::NotSent].map(|warning| LeftOut {
            warning,
            count: 1,
            seconds: 10,
        });
        assert_eq!(log.end_periods(end), left_out);
        assert_eq!(log.deadline(), Some(end.after(SECOND)));
        assert_eq!(log.end_periods(end.after(SECOND)), []);
        assert_eq!(log.deadline(), None);
    }
}
