//! Ticks at regular times, without drift: a machine that takes the time as a value.

#[cfg(test)]
mod tests;

use std::time::Duration;

use sm2_proto::Instant;

/// Nanoseconds of a second.
const SECOND_NS: u64 = 1_000_000_000;

/// Ticks at regular times.
///
/// Tick number `n` is due at `start + n * period`, however late the earlier ticks were handled, so a timer never drifts
/// from its schedule. The clock is the monotonic one of [`now`](crate::now): it does not jump when the time of day is
/// set, and stands still while the host is suspended.
///
/// A timer is a value without a descriptor or a thread. A [`WaitSet`](crate::WaitSet) and an
/// [`Executor`](crate::Executor) own their timers and wait for them, and a [`Rate`](crate::Rate) puts a thread to sleep
/// until the ticks of one. A program with a loop of its own sleeps until [`deadline`](Self::deadline), and then calls
/// [`handle`](Self::handle).
///
/// ```
/// use std::time::Duration;
/// use sm2_node::{Instant, Timer};
///
/// let start = Instant(0);
/// let mut timer = Timer::starting_at(start, Duration::from_millis(10));
/// assert_eq!(timer.deadline(), Some(Instant(10_000_000)));
/// assert!(timer.handle(Instant(9_999_999)).is_none());
/// // The program was busy for two periods and a half: the last tick counts, and the next is on time.
/// let tick = timer.handle(Instant(25_000_000)).unwrap();
/// assert_eq!((tick.number, tick.missed), (2, 1));
/// assert_eq!(timer.deadline(), Some(Instant(30_000_000)));
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Timer {
    start: Instant,
    /// `ticks` ticks take `span_ns` nanoseconds. Neither is zero.
    span_ns: u64,
    ticks: u32,
    missed: MissedTicks,
    /// The number of the next tick; `None` after the only tick of a timer that does not repeat.
    next: Option<u64>,
    repeats: bool,
}

/// The treatment of ticks whose time has passed before the program handled them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum MissedTicks {
    /// Only the newest of them is reported, with the number of those before it ([`Tick::missed`]). For control loops:
    /// after a stall they go on with the present.
    #[default]
    Skip,
    /// Each of them is reported, one after the other without a pause. For work that must be done a certain number of
    /// times. A program that is always too slow falls behind more and more.
    Burst,
}

/// A tick of a [`Timer`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub struct Tick {
    /// The number of the tick; the first one has the number 1.
    pub number: u64,
    /// The time when it was due.
    pub due: Instant,
    /// How many earlier ticks were skipped since the last one that was reported.
    pub missed: u64,
}

impl Timer {
    /// Ticks once in each period. The first tick is due one period from now. A period of zero counts as one
    /// nanosecond, and one above 584 years as never.
    #[must_use]
    pub fn every(period: Duration) -> Self {
        Self::starting_at(sm2_io::clock::now(), period)
    }

    /// Ticks `frequency` times in each second; tick `n` is due `n / frequency` seconds from now, rounded down to a
    /// nanosecond. A frequency of zero counts as one.
    #[must_use]
    pub fn hz(frequency: u32) -> Self {
        Self {
            span_ns: SECOND_NS,
            ticks: frequency.max(1),
            ..Self::every(Duration::ZERO)
        }
    }

    /// Ticks once, after `delay`.
    #[must_use]
    pub fn once(delay: Duration) -> Self {
        Self {
            repeats: false,
            ..Self::every(delay)
        }
    }

    /// As [`every`](Self::every), with a start of the caller's choice: for several timers with one schedule, and for
    /// tests in virtual time.
    #[must_use]
    pub fn starting_at(start: Instant, period: Duration) -> Self {
        Self {
            start,
            span_ns: u64::try_from(period.as_nanos()).unwrap_or(u64::MAX).max(1),
            ticks: 1,
            missed: MissedTicks::Skip,
            next: Some(1),
            repeats: true,
        }
    }

    /// Sets what happens to missed ticks; [`MissedTicks::Skip`] by default.
    #[must_use]
    pub const fn missed_ticks(mut self, missed: MissedTicks) -> Self {
        self.missed = missed;
        self
    }

    /// Ticks `frequency` times in each second, counted from `now`, unless it does so already.
    pub(crate) fn set_hz(&mut self, frequency: u32, now: Instant) {
        let new = Self {
            start: now,
            missed: self.missed,
            ..Self::hz(frequency)
        };
        let has = |it: &Self| (it.repeats, it.span_ns, it.ticks);
        if has(self) != has(&new) {
            *self = new;
        }
    }

    /// The time when the next tick is due; `None` after the only tick of a timer that was made by
    /// [`once`](Self::once).
    #[must_use]
    pub fn deadline(&self) -> Option<Instant> {
        self.next.map(|number| self.due(number))
    }

    /// Returns the tick that is due at `now`, if one is, and goes on to the next one.
    pub fn handle(&mut self, now: Instant) -> Option<Tick> {
        let next = self.next?;
        if self.due(next) > now {
            return None;
        }
        let number = match self.missed {
            MissedTicks::Skip if self.repeats => self.newest(now).max(next),
            MissedTicks::Skip | MissedTicks::Burst => next,
        };
        self.next = self.repeats.then(|| number.saturating_add(1));
        Some(Tick {
            number,
            due: self.due(number),
            missed: number - next,
        })
    }

    /// The time of a tick. A time beyond the clock's range never comes.
    fn due(&self, number: u64) -> Instant {
        let passed = u128::from(number) * u128::from(self.span_ns) / u128::from(self.ticks);
        let passed = u64::try_from(passed).unwrap_or(u64::MAX);
        Instant(self.start.0.saturating_add(passed))
    }

    /// The number of the newest tick that is due at `now`: the greatest `n` with
    /// `n * span_ns / ticks < now - start + 1`.
    fn newest(&self, now: Instant) -> u64 {
        let passed = u128::from(now.0.saturating_sub(self.start.0)) + 1;
        let newest = (passed * u128::from(self.ticks) - 1) / u128::from(self.span_ns);
        u64::try_from(newest).unwrap_or(u64::MAX)
    }
}
