//! Shows the running engine on standard error.

use std::io::{self, IsTerminal, Write as _};
use std::time::{Duration, Instant};

use sm2_verification::properties::Engine;

use crate::verdict::Verdict;

/// The interval of progress lines if the output is not a terminal.
const IN_A_LOG: Duration = Duration::from_secs(60);
const ON_A_TERMINAL: Duration = Duration::from_millis(500);

/// The line of one engine.
pub(crate) struct Screen {
    name: String,
    terminal: bool,
    start: Instant,
    shown: Instant,
}

impl Screen {
    pub(crate) fn new(engine: Engine, number: usize, of: usize) -> Self {
        let now = Instant::now();
        let screen = Self {
            name: format!("[{number:2}/{of}] {engine:<9}"),
            terminal: io::stderr().is_terminal(),
            start: now,
            shown: now,
        };
        if !screen.terminal {
            screen.write("started");
        }
        screen
    }

    /// Shows the progress, if the interval is over.
    pub(crate) fn progress(&mut self, checks: impl FnOnce() -> usize) {
        let every = if self.terminal {
            ON_A_TERMINAL
        } else {
            IN_A_LOG
        };
        if self.shown.elapsed() >= every {
            self.shown = Instant::now();
            let time_s = self.start.elapsed().as_secs();
            self.write(&format!("{} checks so far, {time_s} s", checks()));
        }
    }

    /// Shows the verdict.
    pub(crate) fn ended(&self, verdict: &Verdict, checks: usize) {
        let time_s = self.start.elapsed().as_secs_f64();
        let word = match verdict {
            Verdict::Held => format!("{checks} checks, {time_s:.1} s"),
            Verdict::Skipped { why } => format!("skipped: {why}"),
            Verdict::Failed { why } => format!("FAILED after {time_s:.1} s: {why}"),
        };
        self.write(&word);
        if self.terminal {
            let _ = writeln!(io::stderr());
        }
    }

    fn write(&self, word: &str) {
        let mut out = io::stderr().lock();
        // A closed standard error is not a failure.
        let _ = if self.terminal {
            write!(out, "\r\x1b[2K{}  {word}", self.name)
        } else {
            writeln!(out, "{}  {word}", self.name)
        };
        let _ = out.flush();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_is_shown_when_the_interval_is_over() {
        let now = Instant::now();
        for (shown, is_due) in [(now + 2 * IN_A_LOG, false), (now - IN_A_LOG, true)] {
            let mut screen = Screen {
                name: "[ 1/1] model".to_owned(),
                terminal: false,
                start: now,
                shown,
            };
            let mut asked = false;
            screen.progress(|| {
                asked = true;
                3
            });
            assert_eq!(asked, is_due);
            assert_eq!(screen.shown != shown, is_due);
        }
    }
}
