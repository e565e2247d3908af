//! The progress of long work, on standard error.

use std::{
    fmt,
    io::{self, IsTerminal},
    time::Duration,
};

use sm2_io::clock;
use sm2_proto::Instant;

use crate::stderr;

/// How often the progress is shown.
const PROGRESS: Duration = Duration::from_secs(1);

/// Shows the progress once per second on a terminal, in one line that it writes anew each time.
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

    /// Whether the progress is shown: standard error is a terminal.
    pub(crate) const fn is_shown(&self) -> bool {
        self.is_shown
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
                stderr::progress(&progress().to_string());
            }
        }
    }
}

impl Drop for Ticker {
    fn drop(&mut self) {
        stderr::end_progress();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_goes_on_until_it_is_due_and_no_longer_than_to_the_next_line() {
        let ticker = Ticker::new();
        assert_eq!(ticker.left(clock::now()), Duration::ZERO);
        assert!(ticker.left(Instant(u64::MAX)) <= PROGRESS);
    }
}
