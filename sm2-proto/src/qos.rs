//! The times of the quality of service: periods, deadlines and leases.
//!
//! A deadline costs no message anything. A tick at the end of each period looks for the newest message, in the machine
//! or in the ring, so a receiver does nothing when a message comes. A domain without deadlines has no timer, and one
//! with deadlines wakes at most once in each period. A message counts by its time of publication, because the tick may
//! find it late.
//!
//! Only the program asserts its liveliness: a background thread that did so would hide that the program hangs, and the
//! end of a process is known by its links. Leases are checked at the same ticks as deadlines. ALIVE goes through the
//! socket on both lanes, at most four times in a lease, so that it does not fill the socket of a subscriber that reads
//! seldom.

use core::{fmt, mem, time::Duration};

use serde::{Deserialize, Serialize};

use crate::Instant;

/// A time of the quality of service, or none. On the wire it is a number of nanoseconds, and 0 is none.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct Period(pub u64);

impl Period {
    /// No time.
    pub const NONE: Self = Self(0);

    /// This time, limited to 1 ns to 2^64 - 1 ns.
    #[must_use]
    pub const fn new(time: Duration) -> Self {
        let nanos = time.as_nanos();
        if nanos == 0 {
            Self(1)
        } else if nanos > u64::MAX as u128 {
            Self(u64::MAX)
        } else {
            Self(nanos as u64)
        }
    }

    /// The time; `None` if there is none.
    #[must_use]
    pub const fn get(self) -> Option<Duration> {
        match self.0 {
            0 => None,
            nanos => Some(Duration::from_nanos(nanos)),
        }
    }

    /// Whether this time has passed since a moment. Never, if there is no time.
    #[must_use]
    pub const fn has_passed(self, since: Instant, now: Instant) -> bool {
        self.0 != 0 && now.0.saturating_sub(since.0) >= self.0
    }

    /// As [`has_passed`](Self::has_passed), but reads the clock only if there is a time.
    #[must_use]
    #[inline]
    pub fn has_passed_by(self, since: Instant, now: impl FnOnce() -> Instant) -> bool {
        self != Self::NONE && self.has_passed(since, now())
    }

    /// Whether an offer of this time fulfils a demand: there is no demand, or the offer is not longer.
    #[must_use]
    pub const fn fulfils(self, demand: Self) -> bool {
        demand.0 == 0 || (self.0 != 0 && self.0 <= demand.0)
    }
}

/// `1.5s`, or `none`.
impl fmt::Display for Period {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.get() {
            Some(time) => write!(f, "{time:?}"),
            None => f.write_str("none"),
        }
    }
}

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

/// Watches whether a publisher's program shows in time that it is alive.
///
/// The caller calls [`check`](Self::check) at the time of [`due`](Self::due).
//= SM2-QOS-012
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct LeaseWatch {
    lease: Period,
    /// The time of the last sign of life, or the start.
    last: Instant,
    /// The time from which the next check is one lease away.
    base: Instant,
    /// The number of the newest message at the last check; zero if there was none.
    newest: u64,
    is_alive: bool,
    /// The result of the last [`take_change`](Self::take_change), or `true`.
    told: bool,
    losses: u64,
}

impl LeaseWatch {
    /// The program is alive now; `None` if there is no lease.
    #[must_use]
    pub const fn new(lease: Period, now: Instant) -> Option<Self> {
        if lease.0 == 0 {
            return None;
        }
        Some(Self {
            lease,
            last: now,
            base: now,
            newest: 0,
            is_alive: true,
            told: true,
            losses: 0,
        })
    }

    /// The time of the next check.
    #[must_use]
    pub const fn due(&self) -> Instant {
        Instant(self.base.0.saturating_add(self.lease.0))
    }

    /// Whether the program has shown in time that it is alive.
    #[must_use]
    pub const fn is_alive(&self) -> bool {
        self.is_alive
    }

    /// Whether the program is alive, if that has changed since the last call.
    pub fn take_change(&mut self) -> Option<bool> {
        let changed = mem::replace(&mut self.told, self.is_alive) != self.is_alive;
        changed.then_some(self.is_alive)
    }

    /// How often the program stopped being alive.
    #[must_use]
    pub const fn losses(&self) -> u64 {
        self.losses
    }

    /// The program showed at `time` that it is alive. The other end tells this time, so a time in the future counts
    /// as now.
    pub fn assert(&mut self, time: Instant, now: Instant) {
        self.note(time, now);
        self.is_alive |= !self.lease.has_passed(self.last, now);
    }

    /// Checks whether the last sign of life is older than the lease.
    pub fn check(&mut self, newest: Newest, now: Instant) {
        match newest.time {
            Some(time) => self.note(time, now),
            // The time is known once the message was taken.
            None if newest.sequence != self.newest => self.note(now, now),
            None => {}
        }
        self.newest = newest.sequence;
        let is_alive = !self.lease.has_passed(self.last, now);
        if self.is_alive && !is_alive {
            self.losses = self.losses.saturating_add(1);
        }
        self.is_alive = is_alive;
        self.base = if is_alive { self.last } else { now };
    }

    fn note(&mut self, time: Instant, now: Instant) {
        self.last = self.last.max(time.min(now));
    }
}
