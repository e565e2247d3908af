//! One moment, as the machines and as QUIC count it.

use std::time;

use sm2_proto::Instant;

/// A moment.
#[derive(Clone, Copy, Debug)]
pub struct Now {
    /// For the machines.
    pub at: Instant,
    /// For QUIC.
    pub quic: time::Instant,
}

/// What belongs together of the two.
#[derive(Clone, Copy, Debug)]
pub struct Clock(Now);

impl Clock {
    /// From one moment on.
    #[must_use]
    pub const fn new(start: Now) -> Self {
        Self(start)
    }

    /// The clock of this machine.
    #[must_use]
    pub fn of_the_machine() -> Self {
        Self(Now {
            at: sm2_io::clock::now(),
            quic: time::Instant::now(),
        })
    }

    /// The same moment for both.
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

    /// The current moment of this machine.
    #[must_use]
    pub fn now(&self) -> Now {
        self.at(sm2_io::clock::now())
    }

    /// What QUIC calls so, for the machines.
    #[must_use]
    pub fn of(&self, quic: time::Instant) -> Instant {
        let since = quic.saturating_duration_since(self.0.quic);
        self.0.at.after(since)
    }
}
