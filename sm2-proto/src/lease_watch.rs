//! Liveliness: who asserts it, and how often.
//!
//! Only the program asserts its liveliness: a background thread that did so would hide that the program hangs, and the
//! end of a process is known by its links. Leases are checked at the same ticks as deadlines. ALIVE goes through the
//! socket on both lanes, at most four times in a lease, so that it does not fill the socket of a subscriber that reads
//! seldom.

use core::mem;

use crate::{Instant, Newest, Period};

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
