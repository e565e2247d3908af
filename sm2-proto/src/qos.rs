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

/// Watches whether a publisher keeps the times of its QoS: a message in each period of its deadline, and a sign of life
/// within its lease. A publisher watches itself, and a receiver the publisher at the other end. The default watches
/// nothing.
///
/// The caller calls [`check`](Self::check) at the time of [`due`](Self::due). A receiver need do nothing when a message
/// comes.
//= SM2-QOS-009, SM2-QOS-011
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct QosWatch {
    deadline: Option<Timer>,
    /// How many periods of the deadline have passed without a message.
    missed: u64,
    /// The result of the last [`take_missed`](Self::take_missed).
    told_missed: u64,
    lease: Option<Timer>,
    /// Whether the last sign of life was older than the lease.
    is_lost: bool,
    /// The result of the last [`take_liveliness_change`](Self::take_liveliness_change).
    told_lost: bool,
    losses: u64,
    /// The number of the newest message at the last check; zero if there was none.
    newest: u64,
}

/// The time that may pass from one sign of a publisher to the next one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Timer {
    /// Not none.
    period: Period,
    /// The time of the last sign, or of the start. Of a deadline, the end of the last period that was missed is one.
    last: Instant,
    /// The next check is one period later. After `last` if a message has come whose time is not known.
    base: Instant,
}

/// The newest message at a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Newest {
    /// The number of the message, which grows with each message; zero if there was none.
    pub sequence: u64,
    /// The time of its publication; `None` if the message waits in a ring: it is known once the message was taken.
    pub time: Option<Instant>,
}

impl Newest {
    /// There was no message. A publisher checks itself with it.
    pub const NONE: Self = Self {
        sequence: 0,
        time: None,
    };
}

impl Timer {
    fn new(period: Period, now: Instant) -> Option<Self> {
        (period != Period::NONE).then_some(Self {
            period,
            last: now,
            base: now,
        })
    }

    const fn due(&self) -> Instant {
        Instant(self.base.0.saturating_add(self.period.0))
    }

    /// There was a sign at this time. The other end tells it, so a time in the future counts as now.
    fn sign(&mut self, time: Instant, now: Instant) {
        self.last = self.last.max(time.min(now));
    }

    /// Whether the last sign is a period old.
    const fn is_over(&self, now: Instant) -> bool {
        self.period.has_passed(self.last, now)
    }

    /// Ends the periods that have passed since `base`. Returns their number.
    fn end_periods(&mut self, now: Instant) -> u64 {
        let passed = now.0.saturating_sub(self.base.0) / self.period.0;
        if passed > 0 {
            self.base = Instant(self.base.0 + passed * self.period.0);
            self.last = self.base;
        }
        passed
    }
}

impl QosWatch {
    /// Watches from now on.
    #[must_use]
    pub fn new(deadline: Period, lease: Period, now: Instant) -> Self {
        Self {
            deadline: Timer::new(deadline, now),
            lease: Timer::new(lease, now),
            ..Self::default()
        }
    }

    /// The time of the next check; `None` if there is nothing to watch.
    #[must_use]
    pub fn due(&self) -> Option<Instant> {
        let timers = self.deadline.iter().chain(&self.lease);
        timers.map(Timer::due).min()
    }

    /// Whether there is a lease.
    #[must_use]
    #[inline]
    pub const fn has_lease(&self) -> bool {
        self.lease.is_some()
    }

    /// The publisher publishes now.
    #[inline]
    pub fn published(&mut self, now: Instant) {
        if let Some(deadline) = &mut self.deadline {
            self.missed = self.missed.saturating_add(deadline.end_periods(now));
            deadline.sign(now, now);
            deadline.base = deadline.last;
        }
        self.assert(now, now);
    }

    /// The publisher's program showed at `time` that it is alive.
    pub fn assert(&mut self, time: Instant, now: Instant) {
        if let Some(lease) = &mut self.lease {
            lease.sign(time, now);
            self.is_lost &= lease.is_over(now);
        }
    }

    /// Counts the periods of the deadline that have passed now, and checks whether the last sign of life is older than
    /// the lease.
    pub fn check(&mut self, newest: Newest, now: Instant) {
        let is_unknown = newest.time.is_none() && newest.sequence != self.newest;
        self.newest = newest.sequence;
        if let Some(deadline) = &mut self.deadline {
            if let Some(time) = newest.time {
                deadline.sign(time, now);
                deadline.base = deadline.last;
            } else if is_unknown {
                deadline.base = now;
            }
            self.missed = self.missed.saturating_add(deadline.end_periods(now));
        }
        if let Some(lease) = &mut self.lease {
            if let Some(time) = newest.time.or(is_unknown.then_some(now)) {
                lease.sign(time, now);
            }
            let is_lost = lease.is_over(now);
            self.losses = (self.losses).saturating_add(u64::from(is_lost && !self.is_lost));
            self.is_lost = is_lost;
            lease.base = if is_lost { now } else { lease.last };
        }
    }

    /// How many periods of the deadline have passed without a message.
    #[must_use]
    pub const fn missed_deadlines(&self) -> u64 {
        self.missed
    }

    /// How many more periods have passed without a message than at the last call.
    pub const fn take_missed(&mut self) -> u64 {
        self.missed - mem::replace(&mut self.told_missed, self.missed)
    }

    /// Whether the program has shown in time that it is alive. Always true without a lease.
    #[must_use]
    pub const fn is_alive(&self) -> bool {
        !self.is_lost
    }

    /// Whether the program is alive, if that has changed since the last call.
    #[inline]
    pub fn take_liveliness_change(&mut self) -> Option<bool> {
        let was_lost = mem::replace(&mut self.told_lost, self.is_lost);
        (was_lost != self.is_lost).then_some(!self.is_lost)
    }

    /// How often the program stopped being alive.
    #[must_use]
    pub const fn lost_liveliness(&self) -> u64 {
        self.losses
    }
}

/// The ALIVE frames of one link: at most one in each quarter of the lease.
//= SM2-QOS-012
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) struct AliveFrames {
    /// The time in an ALIVE that has to be sent.
    due: Option<Instant>,
    /// The time of the newest assertion that came too soon after the last ALIVE.
    held: Option<Instant>,
    /// The earliest time for another ALIVE.
    next: Instant,
}

impl AliveFrames {
    /// The program is alive at this time. If the assertion before was not sent yet, only this one is.
    pub(crate) const fn assert(&mut self, lease: Period, time: Instant) {
        if self.due.is_none() && time.0 < self.next.0 {
            self.held = Some(time);
        } else {
            self.send(lease, time, time);
        }
    }

    /// Sends the assertion that was held back, once it is time.
    pub(crate) const fn send_held(&mut self, lease: Period, now: Instant) {
        if now.0 >= self.next.0
            && let Some(time) = self.held
        {
            self.send(lease, time, now);
        }
    }

    const fn send(&mut self, lease: Period, time: Instant, now: Instant) {
        self.due = Some(time);
        self.held = None;
        self.next = Instant(now.0.saturating_add(lease.0 / 4));
    }

    /// The time in the ALIVE that is sent now, if one has to be sent.
    pub(crate) const fn take(&mut self) -> Option<Instant> {
        self.due.take()
    }

    /// The time when an assertion is sent that was held back.
    pub(crate) fn held_until(&self) -> Option<Instant> {
        self.held.map(|_| self.next)
    }
}
