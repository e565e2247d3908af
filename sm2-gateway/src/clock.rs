//! The time of the machines and of QUIC.

use std::time;

use sm2_proto::Instant;

/// A point in time, in both representations.
#[derive(Clone, Copy, Debug)]
pub struct Now {
    /// For the machines.
    pub at: Instant,
    /// For QUIC.
    pub quic: time::Instant,
}

/// Converts between both representations of time.
#[derive(Clone, Copy, Debug)]
pub struct Clock(Now);

impl Clock {
    /// A clock that starts at `start`.
    #[must_use]
    pub const fn new(start: Now) -> Self {
        Self(start)
    }

    /// The monotonic clock of the system.
    #[must_use]
    pub fn of_the_machine() -> Self {
        Self(Now {
            at: sm2_io::clock::now(),
            quic: time::Instant::now(),
        })
    }

    /// Converts a machine's time.
    #[must_use]
    pub fn at(&self, at: Instant) -> Now {
        let Now {
            at: start,
            quic: quic_start,
        } = self.0;
        Now {
            at,
            quic: quic_start + at.since(start),
        }
    }

    /// The current time of the system.
    #[must_use]
    pub fn now(&self) -> Now {
        self.at(sm2_io::clock::now())
    }

    /// Converts a time of QUIC.
    #[must_use]
    pub fn of(&self, quic: time::Instant) -> Instant {
        let since = quic.saturating_duration_since(self.0.quic);
        self.0.at.after(since)
    }
}
