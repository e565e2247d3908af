//! The summary that `sm2 topic pub` prints at its end.

use std::fmt;

use sm2_proto::{link::Counters, text::Counted};

use crate::size::Size;

/// The counts of published messages.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Tally {
    pub(super) messages: u64,
    pub(super) bytes: u64,
    /// The number of messages that were published while there was no subscriber.
    pub(super) unheard: u64,
    /// The largest number of links that a message was sent on.
    pub(super) links: usize,
}

/// The summary: the messages that were published, and their fates on all links together.
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
            write!(f, ", {} without a subscriber", tally.unheard)?;
        }
        if counters.in_flight > 0 {
            write!(f, ", {} still in flight", counters.in_flight)?;
        }
        let dropped = [
            (counters.overwritten, "overwritten before they were sent"),
            (counters.discarded, "overwritten before they were received"),
            (
                counters.deadline,
                "at the deadline of a subscriber without room",
            ),
            (counters.closed, "to subscribers that left"),
            (
                counters.pool_limit,
                "at --pool-limit, to subscribers that hold samples",
            ),
            (counters.too_long, "longer than their subscribers accept"),
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
