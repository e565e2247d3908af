//! The progress of `sm2 play` on a terminal.

use std::{
    fmt,
    sync::mpsc::{self, RecvTimeoutError, Sender},
    thread::{self, JoinHandle},
};

use sm2_bag::{Bag, Filter, PlayControl, PlayStatus};
use sm2_proto::{Instant, text::Counted};

use crate::ticker::Ticker;

/// A thread that shows the progress of a replay. Dropping it ends the line.
pub(super) struct ShownProgress {
    end: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl ShownProgress {
    /// Shows the progress from now on, if standard error is a terminal.
    pub(super) fn start(control: PlayControl, range: Range) -> Self {
        let mut ticker = Ticker::new();
        if !ticker.is_shown() {
            return Self {
                end: None,
                thread: None,
            };
        }
        let (end, ended) = mpsc::channel();
        let thread = thread::spawn(move || {
            let left = |ticker: &Ticker| ticker.left(Instant(u64::MAX));
            // The other side is dropped at the end.
            while ended.recv_timeout(left(&ticker)) == Err(RecvTimeoutError::Timeout) {
                ticker.tick(|| range.progress(control.status()));
            }
        });
        Self {
            end: Some(end),
            thread: Some(thread),
        }
    }
}

impl Drop for ShownProgress {
    fn drop(&mut self) {
        drop(self.end.take());
        // The thread has no panic to report.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

/// The times of the messages that are played, in nanoseconds of the wall clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Range {
    from_ns: u64,
    to_ns: u64,
}

impl Range {
    /// The times of the messages of bags that pass a filter.
    pub(super) fn new(bags: &[Bag], filter: &Filter) -> Self {
        let reports: Vec<_> = bags.iter().map(Bag::report).collect();
        let from = reports.iter().filter_map(|it| it.start_ns).min();
        let to = reports.iter().filter_map(|it| it.end_ns).max();
        let from_ns = from.unwrap_or_default().max(filter.from_ns.unwrap_or(0));
        let to_ns = to.unwrap_or_default();
        Self {
            from_ns,
            to_ns: to_ns.min(filter.to_ns.unwrap_or(u64::MAX)).max(from_ns),
        }
    }

    const fn progress(self, status: PlayStatus) -> Progress {
        Progress {
            range: self,
            status,
        }
    }
}

struct Progress {
    range: Range,
    status: PlayStatus,
}

/// `12.5 of 60.0 s (20 %), 375 messages, rate 2, paused`
impl fmt::Display for Progress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Range { from_ns, to_ns } = self.range;
        // Latched messages of before the range are played first.
        let at_ns = self.status.time_ns.unwrap_or(from_ns).clamp(from_ns, to_ns);
        let (done_ns, all_ns) = (at_ns - from_ns, to_ns - from_ns);
        let seconds = |ns: u64| ns as f64 / 1e9;
        let percent = (u128::from(done_ns) * 100).checked_div(u128::from(all_ns));
        let messages = Counted::new(self.status.messages, "message");
        write!(f, "{:.1} of {:.1} s", seconds(done_ns), seconds(all_ns))?;
        write!(f, " ({} %), {messages}", percent.unwrap_or(100))?;
        if self.status.rate != 1.0 {
            write!(f, ", rate {}", self.status.rate)?;
        }
        match self.status.paused {
            true => f.write_str(", paused"),
            false => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_is_a_place_in_the_range() {
        const S: u64 = 1_000_000_000;
        let range = Range {
            from_ns: 10 * S,
            to_ns: 70 * S,
        };
        let status = PlayStatus {
            paused: false,
            rate: 1.0,
            messages: 375,
            time_ns: Some(22 * S + S / 2 + 7),
        };
        let text = |range: Range, status| range.progress(status).to_string();
        assert_eq!(text(range, status), "12.5 of 60.0 s (20 %), 375 messages");
        let paused = PlayStatus {
            paused: true,
            rate: 2.0,
            time_ns: None,
            messages: 0,
        };
        let shown = "0.0 of 60.0 s (0 %), 0 messages, rate 2, paused";
        assert_eq!(text(range, paused), shown);
        let early = PlayStatus {
            time_ns: Some(S),
            ..status
        };
        assert_eq!(text(range, early), "0.0 of 60.0 s (0 %), 375 messages");
        let one = Range {
            to_ns: range.from_ns,
            ..range
        };
        assert_eq!(text(one, status), "0.0 of 0.0 s (100 %), 375 messages");
    }
}
