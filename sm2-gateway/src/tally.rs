//! Counts of the messages and calls of a connection: in total, and for each topic and service.
//!
//! A connection and the hub each count what they see; a report adds both up. A name keeps its counts
//! when its offer is withdrawn and offered again, so that the counters of a connection only grow.
//!
//! Nothing else is written while a connection runs. A report requests the counts of all connections at the same time,
//! and waits a quarter of a second for them. It claims only known facts: the numbers that an origin gives its messages
//! reveal a gap but not its cause, so `skipped` is not `lost`.

use std::{collections::BTreeMap, ops::AddAssign};

use sm2_proto::{
    Name,
    gateway::{OfferId, Subject, SubjectKind},
    limits::OFFERS_MAX,
};

/// Limit of names without an offer: twice as many as both sides may offer at a time.
const NAMES_MAX: usize = 4 * OFFERS_MAX;

/// Counts of messages; for a service, of requests and replies.
///
/// Each message for the peer that is counted in `offered` is later counted in one of `sent`,
/// `superseded`, `expired` and `withdrawn`, or is still queued. A message counted in `lost` is not
/// counted in `offered`, nor is one that is counted in `refused`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
pub struct Counts {
    /// For the peer: handed to the scheduler, because the peer wants the topic.
    pub offered: u64,
    /// Of these: completely written to QUIC.
    pub sent: u64,
    /// Of these: dropped by the scheduler in favour of newer ones, of the same topic or, above the
    /// memory budget of the peer, of others.
    pub superseded: u64,
    /// Of these: dropped by the scheduler because they exceeded their maximum age.
    pub expired: u64,
    /// Of these: dropped because the peer no longer wants the topic.
    pub withdrawn: u64,
    /// From the peer: received completely.
    pub received: u64,
    /// From the peer: refused, since they were too long, too many at a time, or stuck. For the peer:
    /// refused, since a message of the domain was too long.
    pub refused: u64,
    /// Dropped because a queue of this gateway was full: the queue of the peer's connection, the queue
    /// of the domain's side, or the requests and replies for the peer; or because the message could not
    /// be published in the domain.
    pub lost: u64,
    /// From the peer: gaps in the numbers of the origin while the topic was wanted. This gateway cannot
    /// tell whether the missing messages were superseded, expired, overtaken or lost.
    pub skipped: u64,
}

#[cfg(test)]
impl Counts {
    /// A value of its own for each count, in their order from 1 on.
    pub(crate) const ALL_DIFFERENT: Self = Self {
        offered: 1,
        sent: 2,
        superseded: 3,
        expired: 4,
        withdrawn: 5,
        received: 6,
        refused: 7,
        lost: 8,
        skipped: 9,
    };
}

impl AddAssign for Counts {
    fn add_assign(&mut self, other: Self) {
        let Self {
            offered,
            sent,
            superseded,
            expired,
            withdrawn,
            received,
            refused,
            lost,
            skipped,
        } = other;
        self.offered += offered;
        self.sent += sent;
        self.superseded += superseded;
        self.expired += expired;
        self.withdrawn += withdrawn;
        self.received += received;
        self.refused += refused;
        self.lost += lost;
        // Saturates, since the peer chooses the numbers.
        self.skipped = self.skipped.saturating_add(skipped);
    }
}

/// The side that made an offer, and the number of the offer: each side numbers its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Whose {
    Ours(OfferId),
    Theirs(OfferId),
}

/// A topic or service, identified by kind and name, whatever its types.
pub(crate) type Key = (SubjectKind, Name);

/// The counters of a connection.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tally {
    total: Counts,
    names: BTreeMap<Key, Named>,
    offers: BTreeMap<Whose, Key>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Named {
    counts: Counts,
    /// The number of its current offers.
    offers: usize,
}

impl Tally {
    /// Starts to count an offer under its name.
    pub(crate) fn open(&mut self, offer: Whose, subject: &Subject) {
        let key = (subject.kind(), subject.name().clone());
        if self.names.len() >= NAMES_MAX && !self.names.contains_key(&key) {
            self.names.retain(|_, it| it.offers > 0);
        }
        self.names.entry(key.clone()).or_default().offers += 1;
        let before = self.offers.insert(offer, key);
        self.is_closed(before);
    }

    /// The offer is withdrawn. Its name keeps its counts.
    pub(crate) fn close(&mut self, offer: Whose) {
        let gone = self.offers.remove(&offer);
        self.is_closed(gone);
    }

    /// Counts an event of an offer. An unknown offer counts only in the total.
    pub(crate) fn count(&mut self, offer: Whose, what: impl Fn(&mut Counts)) {
        what(&mut self.total);
        let key = self.offers.get(&offer);
        if let Some(it) = key.and_then(|key| self.names.get_mut(key)) {
            what(&mut it.counts);
        }
    }

    /// The name under which an offer is counted.
    pub(crate) fn key(&self, offer: Whose) -> Option<&Key> {
        self.offers.get(&offer)
    }

    pub(crate) const fn total(&self) -> Counts {
        self.total
    }

    /// The names that have counts or a current offer.
    pub(crate) fn names(&self) -> impl Iterator<Item = (&Key, Counts)> {
        let is_of_use = |(_, it): &(&Key, &Named)| it.offers > 0 || it.counts != Counts::default();
        let names = self.names.iter().filter(is_of_use);
        names.map(|(key, it)| (key, it.counts))
    }

    /// Frees one entry of the tables. False if none is left.
    pub(crate) fn free_entry(&mut self) -> bool {
        self.offers.pop_first().is_some() || self.names.pop_first().is_some()
    }

    fn is_closed(&mut self, key: Option<Key>) {
        if let Some(it) = key.and_then(|key| self.names.get_mut(&key)) {
            it.offers -= 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use sm2_proto::TypeId;

    use super::*;

    fn topic(name: &str) -> Subject {
        let bytes = TypeId {
            name: Name::new("bytes").unwrap(),
            hash: 0,
        };
        Subject::Topic {
            name: Name::new(name).unwrap(),
            data: bytes,
            reliable: false,
            latched: 0,
        }
    }

    #[test]
    fn a_name_goes_on_counting_when_its_offer_is_another() {
        let mut tally = Tally::default();
        tally.open(Whose::Ours(OfferId(1)), &topic("a"));
        tally.count(Whose::Ours(OfferId(1)), |it| it.sent += 1);
        // The peer's offer 1 is another offer, and no offer has the number 7.
        tally.count(Whose::Theirs(OfferId(1)), |it| it.received += 1);
        tally.count(Whose::Ours(OfferId(7)), |it| it.lost += 1);
        tally.close(Whose::Ours(OfferId(1)));
        tally.count(Whose::Ours(OfferId(1)), |it| it.sent += 1);
        tally.open(Whose::Ours(OfferId(2)), &topic("a"));
        tally.count(Whose::Ours(OfferId(2)), |it| it.sent += 1);
        let names: Vec<_> = tally
            .names()
            .map(|((_, name), it)| (name.as_str(), it.sent))
            .collect();
        assert_eq!(names, [("a", 2)]);
        let total = tally.total();
        assert_eq!((total.sent, total.received, total.lost), (3, 1, 1));
    }

    /// Until there are too many names.
    #[test]
    fn a_name_without_an_offer_keeps_its_counts_beside_others() {
        let mut tally = Tally::default();
        for number in 1..=3 {
            tally.open(
                Whose::Ours(OfferId(number)),
                &topic(&format!("name{number}")),
            );
            tally.count(Whose::Ours(OfferId(number)), |it| it.sent += number);
            tally.close(Whose::Ours(OfferId(number)));
        }
        // This one has an offer, and no counts.
        tally.open(Whose::Ours(OfferId(4)), &topic("name4"));
        let names = tally.names();
        let names: Vec<_> = names
            .map(|((kind, name), it)| (*kind, name.as_str(), it.sent))
            .collect();
        let sent = [("name1", 1), ("name2", 2), ("name3", 3), ("name4", 0)];
        assert_eq!(
            names,
            sent.map(|(name, sent)| (SubjectKind::Topic, name, sent))
        );
        // Neither is left.
        tally.open(Whose::Ours(OfferId(5)), &topic("name5"));
        tally.close(Whose::Ours(OfferId(5)));
        assert_eq!(tally.names().count(), 4);
    }

    #[test]
    fn entries_are_freed_until_none_is_left() {
        let mut tally = Tally::default();
        tally.open(Whose::Ours(OfferId(1)), &topic("a"));
        tally.open(Whose::Theirs(OfferId(1)), &topic("b"));
        let freed = std::iter::from_fn(|| tally.free_entry().then_some(()));
        // Two offers and two names.
        assert_eq!(freed.count(), 4);
        assert_eq!((tally.names.len(), tally.offers.len()), (0, 0));
    }

    #[test]
    fn names_that_come_and_go_are_forgotten_where_they_are_too_many() {
        let mut tally = Tally::default();
        tally.open(Whose::Theirs(OfferId(1)), &topic("stays"));
        for number in 2..=NAMES_MAX as u64 + 100 {
            tally.open(
                Whose::Theirs(OfferId(number)),
                &topic(&format!("name{number}")),
            );
            tally.count(Whose::Theirs(OfferId(number)), |it| it.received += 1);
            tally.close(Whose::Theirs(OfferId(number)));
            assert!(tally.names.len() <= NAMES_MAX);
        }
        assert!(tally.names().any(|((_, name), _)| name.as_str() == "stays"));
        assert_eq!(tally.total().received, NAMES_MAX as u64 + 99);
        assert_eq!(tally.offers.len(), 1);
    }

    #[test]
    fn a_sum_has_each_count_once() {
        let counts = |number: u64| Counts {
            offered: number,
            sent: 2 * number,
            superseded: 3 * number,
            expired: 4 * number,
            withdrawn: 5 * number,
            received: 6 * number,
            refused: 7 * number,
            lost: 8 * number,
            skipped: 9 * number,
        };
        let mut sum = counts(100);
        sum += counts(1);
        assert_eq!(sum, counts(101));
        // A peer says which numbers it skips.
        let skipped = u64::MAX;
        sum += Counts {
            skipped,
            ..Counts::default()
        };
        assert_eq!(
            sum,
            Counts {
                skipped,
                ..counts(101)
            }
        );
    }
}
