//! The summary that `sm2 topic pub` prints at its end.

use std::fmt;

use serde::{Serialize, Serializer};
use sm2_proto::{
    link::{Counters, Fate},
    text::Counted,
};

use crate::{size::Size, topic::Fates};

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

/// The object that `--json` prints.
impl Serialize for Summary {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        #[derive(Serialize)]
        struct Object {
            messages: u64,
            bytes: u64,
            /// The largest number of subscribers that a message was sent to.
            subscribers: usize,
            unheard: u64,
            counters: Fates,
        }
        let Self(tally, counters) = *self;
        Object {
            messages: tally.messages,
            bytes: tally.bytes,
            subscribers: tally.links,
            unheard: tally.unheard,
            counters: Fates(counters),
        }
        .serialize(serializer)
    }
}

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
        let dropped = Fate::ALL
            .into_iter()
            .filter_map(|fate| Some((counters.of(fate), reason(fate)?)))
            .filter(|(count, _)| *count > 0);
        let reasons: Vec<_> = dropped
            .map(|(count, reason)| format!("{count} {reason}"))
            .collect();
        write!(f, ", {} dropped", counters.dropped())?;
        match reasons.is_empty() {
            true => Ok(()),
            false => write!(f, " ({})", reasons.join(", ")),
        }
    }
}

/// Why a message with this fate was dropped; `None` if it was delivered.
fn reason(fate: Fate) -> Option<&'static str> {
    let texts = [
        (Fate::Overwritten, "overwritten before they were sent"),
        (Fate::Discarded, "overwritten before they were received"),
        (Fate::NoRoom, "at the deadline of a subscriber without room"),
        (Fate::Closed, "to subscribers that left"),
        (
            Fate::PoolLimit,
            "at --pool-limit, to subscribers that hold samples",
        ),
        (Fate::TooLong, "longer than their subscribers accept"),
        (Fate::Expired, "older than their --lifespan"),
    ];
    let text = texts.into_iter().find(|it| it.0 == fate);
    let text = text.map_or(fate.as_str(), |it| it.1);
    fate.is_drop().then_some(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Each message that was offered is among the numbers: delivered, in flight, or dropped for a reason.
    #[test]
    fn the_summary_has_every_fate() {
        let mut counters = Counters {
            in_flight: 1,
            ..Counters::default()
        };
        for (place, fate) in Fate::ALL.into_iter().enumerate() {
            *counters.of_mut(fate) = 10 << place;
        }
        counters.offered = 1 + counters.delivered + counters.dropped();
        assert!(counters.is_balanced());
        let text = Summary(Tally::default(), counters).to_string();
        let (_, counts) = text.split_once(": ").unwrap();
        let (dropped, reasons) = counts.split_once(" (").unwrap();
        assert!(
            dropped.ends_with(&format!("{} dropped", counters.dropped())),
            "{text}"
        );
        let first = |it: &str| {
            it.trim_end_matches(')')
                .split(' ')
                .next()?
                .parse::<u64>()
                .ok()
        };
        let sum: u64 = reasons.split(", ").filter_map(first).sum();
        assert_eq!(sum, counters.dropped(), "{text}");
    }
    #[test]
    fn nothing_that_did_not_occur_is_named() {
        let tally = Tally {
            messages: 2,
            bytes: 6,
            unheard: 0,
            links: 1,
        };
        let counters = Counters {
            offered: 2,
            delivered: 2,
            ..Counters::default()
        };
        assert_eq!(
            Summary(tally, counters).to_string(),
            "published 2 messages (6 bytes) to 1 subscriber: 2 delivered, 0 dropped"
        );
    }
}
