//! Deadlines: when they are checked, and why that is not done with each message.
//!
//! A deadline costs no message anything. A tick at the end of each period looks for the newest message, in the machine
//! or in the ring, so a receiver does nothing when a message comes. A domain without deadlines has no timer, and one
//! with deadlines wakes at most once in each period. A message counts by its time of publication, because the tick may
//! find it late.

use crate::{Instant, Period};

/// Counts the periods of a deadline that pass without a message.
///
/// The caller calls [`check`](Self::check) at the time of [`due`](Self::due). Messages need no call, except those of a
/// publisher: only it knows the time of each message that was published since the last check.
//= SM2-QOS-009
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct DeadlineWatch {
    /// The period in nanoseconds, not zero.
    period_ns: u64,
    /// The time of the last message, or the end of the last period that was missed, or the start.
    last: Instant,
    /// The start of the present period: later than `last` if the last check found a message whose time it did not
    /// know.
    base: Instant,
    /// The number of the newest message at the last check; zero if there was none.
    newest: u64,
    missed: u64,
}

/// The newest message at a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Newest {
    /// The number of the message, which grows with each message; zero if there was none.
    pub sequence: u64,
    /// The time of its publication; `None` if the message waits in a ring.
    pub time: Option<Instant>,
}

impl Newest {
    /// There was no message.
    pub const NONE: Self = Self {
        sequence: 0,
        time: None,
    };
}

impl DeadlineWatch {
    /// Starts the first period now; `None` if there is no deadline.
    #[must_use]
    pub const fn new(deadline: Period, now: Instant) -> Option<Self> {
        if deadline.0 == 0 {
            return None;
        }
        Some(Self {
            period_ns: deadline.0,
            last: now,
            base: now,
            newest: 0,
            missed: 0,
        })
    }

    /// The end of the present period.
    #[must_use]
    pub const fn due(&self) -> Instant {
        Instant(self.base.0.saturating_add(self.period_ns))
    }

    /// How many periods have passed without a message.
    #[must_use]
    pub const fn missed(&self) -> u64 {
        self.missed
    }

    /// A message is published now, which ends the present period.
    pub fn published(&mut self, now: Instant) {
        self.count_missed(now);
        self.last = self.last.max(now);
        self.base = self.last;
    }

    /// Counts the periods that have passed now. The other end tells the time of its message, so a time in the future
    /// counts as now.
    pub fn check(&mut self, newest: Newest, now: Instant) {
        match newest.time {
            Some(time) => {
                self.last = self.last.max(time.min(now));
                self.base = self.last;
            }
            // The time is known once the message was taken.
            None if newest.sequence != self.newest => self.base = now,
            None => {}
        }
        self.newest = newest.sequence;
        self.count_missed(now);
    }

    /// Counts the periods that have passed since the start of the present one.
    pub fn count_missed(&mut self, now: Instant) {
        let passed = now.0.saturating_sub(self.base.0) / self.period_ns;
        if passed > 0 {
            self.missed = self.missed.saturating_add(passed);
            self.base = Instant(self.base.0 + passed * self.period_ns);
            self.last = self.base;
        }
    }
}
