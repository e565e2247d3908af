//! The parts that a recording and a black box share.

use std::{
    fmt,
    io::{self, IsTerminal},
    time::Duration,
};

use sm2_bag::Progress;
use sm2_io::clock;
use sm2_proto::{Instant, text::Counted};

use crate::size::Size;

/// How often the progress is shown.
const PROGRESS: Duration = Duration::from_secs(1);

/// A new name with the date and the time, in UTC.
pub(super) fn new_name(stem: &str) -> String {
    let now = jiff::Timestamp::now();
    format!("{stem}-{}", now.strftime("%Y-%m-%d-%H%M%S"))
}

/// Shows the progress once per second on a terminal.
pub(super) struct Ticker {
    is_shown: bool,
    at: Instant,
}

impl Ticker {
    pub(super) fn new() -> Self {
        Self {
            is_shown: io::stderr().is_terminal(),
            at: clock::now().after(PROGRESS),
        }
    }

    /// The time until the progress is due, or until the end of the recording.
    pub(super) fn left(&self, until: Instant) -> Duration {
        until.min(self.at).since(clock::now())
    }

    /// Shows the progress if it is due.
    pub(super) fn tick(&mut self, progress: impl FnOnce() -> Progress) {
        if clock::now() >= self.at {
            self.at = clock::now().after(PROGRESS);
            if self.is_shown {
                stderr_line!("{}", Shown(progress()));
            }
        }
    }
}

/// The progress, as it is shown on a terminal.
struct Shown(Progress);

impl fmt::Display for Shown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Progress {
            topics,
            messages,
            bytes,
            lost,
            waiting_bytes,
        } = self.0;
        write!(
            f,
            "{}: {} ({}), lost {lost}, {} waiting for the disk",
            Counted::new(topics as u64, "topic"),
            Counted::new(messages, "message"),
            Size(bytes),
            Size(waiting_bytes)
        )
    }
}
