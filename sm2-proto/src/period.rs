//! Times of the quality of service, such as a deadline.

use core::{fmt, time::Duration};

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
