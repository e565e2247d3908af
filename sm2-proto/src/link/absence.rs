//! The messages that a publisher published while it had no link with a subscriber (SM2-QOS-013).
//!
//! A link can end and be made anew between the same two interfaces: after a shortage of descriptors, when a policy
//! allows the pair again, or when another Manager did not adopt the link. The publisher cannot count what it published
//! in between for this subscriber, because there is no link to count it for. The subscriber can: an [`Account`]
//! compares the publisher's own count of its publications with the messages that came.
//!
//! The driver of a subscriber has an account for each link, and one [`Absences`]:
//!
//! | when | it calls |
//! | --- | --- |
//! | OPEN came, and no older link of this publisher has messages to take | [`Absences::take`], then [`Account::open`] |
//! | it takes a message while [`Account::is_settled`] is `false` | [`Account::take`], or [`Account::expire`] |
//! | the link is over and has no message to take | [`Account::close`], then [`Absences::keep`] |
//!
//! The messages of an older link are thereby taken before those of a newer one. The ids of a publisher's messages
//! therefore grow beyond the end of a link, and one number says which messages have a known fate.

use alloc::collections::VecDeque;

use super::Publications;
use crate::{Name, limits::ABSENCES_MAX};

/// The messages of one publisher whose fate a subscriber knows, between two links.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Record {
    /// All messages up to this id have a known fate.
    until: u64,
    /// How many messages after `until` have one.
    known: u64,
    /// How many messages were counted as lost and not reported with a message.
    unreported: u64,
}

/// The account of the messages that a subscriber gets, or misses, of a publisher that it has a link with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Account {
    progress: Progress,
    unreported: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Progress {
    /// The first link of the pair; no message was taken from it. Messages that were published before OPEN do not
    /// count.
    First { published: u64 },
    /// The fate of the messages after `until` is not known, except of `known` ones.
    Behind { until: u64, known: u64 },
    /// All messages up to the last one that was taken have a known fate.
    Settled,
}

/// The messages that a subscriber misses before a message that it takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Missed {
    /// The messages that were lost on the link.
    pub lost: u64,
    /// The messages that were published while there was no link, except for those that [`Account::open`] returned.
    pub away: u64,
    /// The messages that were counted before and have to be reported with this message.
    pub unreported: u64,
}

impl Account {
    /// Begins the account of a link. Returns it with the number of messages that were published while there was no
    /// link, as far as OPEN tells. A `latched` publisher sends some of them again on the new link, so their number is
    /// known with its first message.
    //= SM2-QOS-013
    #[must_use]
    pub const fn open(of: Publications, latched: bool, record: Option<Record>) -> (Self, u64) {
        let Some(record) = record else {
            let published = of.published;
            let account = Self {
                progress: Progress::First { published },
                unreported: 0,
            };
            return (account, 0);
        };
        let Record {
            until,
            known,
            unreported,
        } = record;
        if latched {
            let account = Self {
                progress: Progress::Behind { until, known },
                unreported,
            };
            return (account, 0);
        }
        let away = of.published.saturating_sub(until).saturating_sub(known);
        let account = Self {
            progress: Progress::Behind {
                until: if until > of.published {
                    until
                } else {
                    of.published
                },
                known: 0,
            },
            unreported: unreported.saturating_add(away),
        };
        (account, away)
    }

    /// Whether the account has nothing to say about the messages that are still taken from the link.
    #[must_use]
    #[inline]
    pub const fn is_settled(&self) -> bool {
        matches!(self.progress, Progress::Settled) && self.unreported == 0
    }

    /// Counts a message for the application. `lost` is the number of messages that were lost on the link before it,
    /// since the message before, taken or expired.
    //= SM2-QOS-013
    pub const fn take(&mut self, id: u64, lost: u64) -> Missed {
        let missed = self.expire(id, lost);
        let unreported = self.unreported;
        self.unreported = 0;
        Missed {
            unreported,
            ..missed
        }
    }

    /// Counts a message that has expired, as [`take`](Self::take). The driver reports the returned losses with the next
    /// message.
    //= SM2-QOS-013
    pub const fn expire(&mut self, id: u64, lost: u64) -> Missed {
        let (lost, away) = match self.progress {
            Progress::First { .. } | Progress::Settled => {
                self.progress = Progress::Settled;
                (lost, 0)
            }
            // It was taken before, or has another fate, and so have the messages before it.
            Progress::Behind { until, .. } if id <= until => (0, 0),
            Progress::Behind { until, known } => {
                self.progress = Progress::Settled;
                let missing = (id - until - 1).saturating_sub(known);
                let lost = if lost < missing { lost } else { missing };
                (lost, missing - lost)
            }
        };
        Missed {
            lost,
            away,
            unreported: 0,
        }
    }

    /// Ends the account of a link that no message is taken from any more. `last_id` is the id of the last message that
    /// was taken or has expired, if there is one. `dropped` of the messages after it were counted as lost, and
    /// `unreported` messages before it that no message has reported.
    #[must_use]
    pub const fn close(self, last_id: Option<u64>, dropped: u64, unreported: u64) -> Record {
        let (until, known) = match (self.progress, last_id) {
            (Progress::Behind { until, known }, _) => (until, known),
            (Progress::First { published }, None) => (published, 0),
            (_, Some(last_id)) => (last_id, 0),
            (Progress::Settled, None) => (0, 0),
        };
        Record {
            until,
            known: known.saturating_add(dropped),
            unreported: (self.unreported)
                .saturating_add(dropped)
                .saturating_add(unreported),
        }
    }
}

/// The publishers that a subscriber had a link with and has none now. At most [`ABSENCES_MAX`]; of more, those whose
/// links ended first are forgotten.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub struct Absences {
    /// The node and number of each publisher, the one first whose link ended first.
    records: VecDeque<(Name, u64, Record)>,
}

impl Absences {
    /// Remembers a publisher whose link has ended.
    pub fn keep(&mut self, node: Name, publisher: u64, record: Record) {
        self.take(&node, publisher);
        if self.records.len() >= ABSENCES_MAX {
            self.records.pop_front();
        }
        self.records.push_back((node, publisher, record));
    }

    /// Returns what is remembered of a publisher that has a link again, and forgets it. Another node cannot take the
    /// place of the publisher by its number.
    pub fn take(&mut self, node: &Name, publisher: u64) -> Option<Record> {
        let is_it = |it: &(Name, u64, Record)| it.1 == publisher && it.0 == *node;
        let place = self.records.iter().position(is_it)?;
        self.records.remove(place).map(|it| it.2)
    }
}
