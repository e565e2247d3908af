//! The progress of long work, on standard error.

use std::{
    fmt,
    io::{self, IsTerminal},
    time::Duration,
};

use sm2_io::clock;
use sm2_proto::Instant;

/// How often the progress is shown.
const PROGRESS: Duration = Duration::from_secs(1);

/// Shows the progress once per second on a terminal.
pub(crate) struct Ticker {
    is_shown: bool,
    at: Instant,
}

impl Ticker {
    pub(crate) fn new() -> Self {
        Self {
            is_shown: io::stderr().is_terminal(),
            at: clock::now().after(PROGRESS),
        }
    }

    /// The time until the progress is due, or until this time.
    pub(crate) fn left(&self, until: Instant) -> Duration {
        until.min(self.at).since(clock::now())
    }

    /// Shows the progress if it is due.
    pub(crate) fn tick<D: fmt::Display>(&mut self, progress: impl FnOnce() -> D) {
        if clock::now() >= self.at {
            self.at = clock::now().after(PROGRESS);
            if self.is_shown {
                stderr_line!("{}", progress());
            }
        }
    }
}
