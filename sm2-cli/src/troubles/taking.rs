//! Ends of links that take nothing, and those that hold samples.
//!
//! A process that hangs or is stopped writes no counters. Its entries stay as it left them, and the other end goes on
//! counting, so the two ends together tell that messages wait.

use std::{fmt, time::Duration};

use serde::Serialize;
use sm2_proto::{Instant, counters::Entry, text::Counted};

use super::losing::Losing;
use crate::sampling::{Ends, hundredths};

/// An end that has taken nothing for this time, while messages wait for it, is reported.
const TOO_LONG: Duration = Duration::from_secs(2);

/// A subscriber or server that takes nothing, while messages or requests wait.
#[derive(Serialize)]
pub(crate) struct NotTaking {
    /// The subscriber or server.
    pub(crate) interface: String,
    /// The publisher or client whose messages wait.
    peer: String,
    /// How long it has taken nothing while messages waited.
    seconds: f64,
    /// The number of messages that wait.
    waiting: u64,
    /// The number of samples that the program holds.
    held: u64,
    /// The number of samples that the program can hold; 0 for a server.
    max_held: u64,
}

/// A subscriber that holds all the samples that it can hold.
#[derive(Serialize)]
pub(super) struct Holding {
    /// The subscriber.
    interface: String,
    /// The publisher of the samples.
    peer: String,
    /// How long it has held all of them.
    seconds: f64,
    held: u64,
}

/// Messages that a receiving end has not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Untaken {
    /// Their number, at least one.
    pub(crate) messages: u64,
    /// The time since which the end has taken nothing while messages waited.
    since: Instant,
}

/// The messages that wait at the receiving end of a link. `None` if there are none, or if an end keeps no counters. The
/// messages of a sender that is short of memory are not there yet.
pub(crate) fn untaken(ends: &Ends<'_>) -> Option<Untaken> {
    let (sent, taken) = (ends.sent?, ends.taken?);
    let messages = waiting(sent, taken);
    (messages > 0 && sent.short_since.is_none()).then(|| Untaken {
        messages,
        since: since(sent, taken),
    })
}

/// How many of the messages that were sent have neither been taken nor dropped.
fn waiting(sent: &Entry, taken: &Entry) -> u64 {
    let fates = &sent.fates;
    // Messages that have expired at the receiving end are among the sender's once it knows of them.
    let dropped = fates.dropped() - fates.expired.min(fates.dropped());
    let expired = fates.expired.max(taken.fates.expired);
    let arrived = (fates.offered).saturating_sub(dropped.saturating_add(expired));
    // A server does not take requests that their client has cancelled, but those are no longer in flight.
    let waiting = arrived.saturating_sub(taken.messages);
    waiting.min(fates.in_flight)
}

/// When the end last took a message, or when the first message came after that, as far as the sender
/// remembers the times of its messages.
fn since(sent: &Entry, taken: &Entry) -> Instant {
    let idle = taken.last.max(taken.created).max(sent.created);
    let mut recent = sent.recent();
    let forgets = recent.len() as u64 != sent.messages;
    match recent.next() {
        // There may have been a message between the two.
        Some(oldest) if forgets && oldest > idle.0 => idle,
        oldest => {
            let later = oldest.into_iter().chain(recent).find(|it| *it > idle.0);
            later.map_or(idle, Instant)
        }
    }
}

impl Untaken {
    /// How long the end has taken nothing; `None` if that is not worth a report yet.
    pub(crate) fn too_long(&self, now: Instant) -> Option<Duration> {
        Some(now.since(self.since)).filter(|it| *it >= TOO_LONG)
    }
}

impl NotTaking {
    pub(super) fn find(
        ends: &Ends<'_>,
        now: Instant,
        sender: &str,
        receiver: &str,
    ) -> Option<Self> {
        let untaken = untaken(ends)?;
        let time = untaken.too_long(now)?;
        let taken = ends.taken?;
        Some(Self {
            interface: receiver.to_owned(),
            peer: sender.to_owned(),
            seconds: hundredths(time.as_secs_f64()),
            waiting: untaken.messages,
            held: taken.held,
            max_held: taken.max_held,
        })
    }

    /// Whether messages of the same link are being lost.
    pub(super) fn is_of(&self, losing: &Losing) -> bool {
        losing.is_between(&self.peer, &self.interface)
    }

    fn holds_all(&self) -> bool {
        self.held > 0 && self.held >= self.max_held
    }

    /// The remedy, as an imperative clause.
    pub(crate) fn remedy(&self) -> &'static str {
        match self.holds_all() {
            true => {
                "let its program drop samples, or declare the subscriber with a greater max_borrowed"
            }
            false => "see what its program does, with its log or a debugger",
        }
    }
}

/// `listener:scan has taken nothing for 3 s, while 4 messages of talker:scan wait`
impl fmt::Display for NotTaking {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            interface,
            peer,
            seconds,
            waiting,
            held,
            max_held,
        } = self;
        let waiting = match waiting {
            1 => format!("1 message of {peer} waits"),
            _ => format!("{waiting} messages of {peer} wait"),
        };
        write!(
            f,
            "{interface} has taken nothing for {seconds} s, while {waiting}"
        )?;
        match (held, self.holds_all()) {
            (0, _) => Ok(()),
            (_, true) => write!(
                f,
                "; it holds {}, which is all that it can hold",
                Counted::new(*held, "sample")
            ),
            (_, false) => write!(
                f,
                "; it holds {held} of the {max_held} samples that it can hold"
            ),
        }
    }
}

impl Holding {
    pub(super) fn find(
        ends: &Ends<'_>,
        now: Instant,
        sender: &str,
        receiver: &str,
    ) -> Option<Self> {
        let taken = ends.taken?;
        let time = now.since(taken.last);
        let holds_all = taken.held > 0 && taken.held >= taken.max_held;
        (holds_all && time >= TOO_LONG).then(|| Self {
            interface: receiver.to_owned(),
            peer: sender.to_owned(),
            seconds: hundredths(time.as_secs_f64()),
            held: taken.held,
        })
    }
}

/// `listener:scan has held 4 samples of talker:scan for 3 s, which is all that it can hold`
impl fmt::Display for Holding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            interface,
            peer,
            seconds,
            held,
        } = self;
        let held = Counted::new(*held, "sample");
        write!(
            f,
            "{interface} has held {held} of {peer} for {seconds} s, which is all that it can hold"
        )
    }
}

#[cfg(test)]
mod tests;
