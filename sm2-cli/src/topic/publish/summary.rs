//! What `sm2 topic pub` says at its end.

use std::fmt;

use sm2_proto::{link::Counters, text::Counted};

use crate::size::Size;

/// What was published.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tally {
    pub(super) messages: u64,
    pub(super) bytes: u64,
    /// Messages for which no subscriber was there.
    pub(super) unheard: u64,
    /// The most that a message was sent on.
    pub(super) links: usize,
}

/// What is said at the end: what was published, and what became of it on all links together.
pub(super) struct Summary(pub(super) Tally, pub(super) Counters);

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(tally, counters) = self;
        write!(
            f,
            "published {} ({}) to {}: {} delivered",
            Counted::new(tally.messages, "message"),
            Size(tally.bytes),
            Counted::new(tally.links as u64, "subscriber"),
            counters.delivered,
        )?;
        if tally.unheard > 0 {
            write!(f, ", {} while nobody was there", tally.unheard)?;
        }
        if counters.in_flight > 0 {
            write!(f, ", {} not given back yet", counters.in_flight)?;
        }
        let dropped = [
            (counters.overwritten, "overtaken before they were sent"),
            (counters.discarded, "overtaken before they were taken"),
            (counters.deadline, "too late for a subscriber without room"),
            (counters.closed, "to subscribers that left"),
        ];
        write!(
            f,
            ", {} dropped",
            dropped.iter().map(|(count, _)| count).sum::<u64>()
        )?;
        let reasons: Vec<_> = dropped
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, reason)| format!("{count} {reason}"))
            .collect();
        match reasons.is_empty() {
            true => Ok(()),
            false => write!(f, " ({})", reasons.join(", ")),
        }
    }
}
