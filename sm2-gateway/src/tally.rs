//! What is counted of the messages and calls of a connection: in all, and of each topic and service.
//!
//! A connection and the hub each count what they see; a report adds up what both have. What a name has counted stays when its offer goes and
//! comes again, so that counters of a connection only grow.

use std::{collections::BTreeMap, ops::AddAssign};

use sm2_proto::{
    Name,
    gateway::{OfferId, Subject, SubjectKind},
    limits::OFFERS_MAX,
};

/// So many names are remembered, at least those that are offered: twice as many as both sides may
/// offer at a time.
const NAMES_MAX: usize = 4 * OFFERS_MAX;

/// What became of messages; of a service, of requests and replies.
///
/// Of what is for the peer, each one counted in `offered` ends up in one of `sent`, `superseded`,
/// `expired` and `withdrawn`, or waits. What is in `lost` never got as far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
pub struct Counts {
    /// For the peer: given to its schedule, since the peer wants it.
    pub offered: u64,
    /// Of these: wholly handed to QUIC.
    pub sent: u64,
    /// Of these: dropped by the schedule, since newer ones took their place.
    pub superseded: u64,
    /// Of these: dropped by the schedule, since they were too old before their turn came.
    pub expired: u64,
    /// Of these: nobody wanted them any more.
    pub withdrawn: u64,
    /// From the peer: came, whole.
    pub received: u64,
    /// From the peer: not taken, since they were too long, too many at a time, or stuck.
    pub refused: u64,
    /// Found no room in this gateway's own queues, on their way to the peer's connection or from it
    /// into the domain.
    pub lost: u64,
    /// From the peer: numbers of the origin that were left out, while the topic was wanted. They were
    /// superseded or expired on the way, overtaken by a newer one, or lost elsewhere: from
    /// here these look alike.
    pub skipped: u64,
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
        // A peer can number its messages as it likes.
        self.skipped = self.skipped.saturating_add(skipped);
    }
}

/// Whose offer it is, and its number: each side has its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Whose {
    Ours(OfferId),
    Theirs(OfferId),
}

/// A topic or a service by its name, whatever its types.
pub(crate) type Key = (SubjectKind, Name);

/// The counts of a connection.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tally {
    total: Counts,
    names: BTreeMap<Key, Named>,
    offers: BTreeMap<Whose, Key>,
}

#[derive(Clone, Copy, Debug, Default)]
struct Named {
    counts: Counts,
    /// How many offers it has.
    offers: usize,
}

impl Tally {
    /// There is an offer: what is counted of it is counted of its name.
    pub(crate) fn open(&mut self, offer: Whose, subject: &Subject) {
        let key = (subject.kind(), subject.name().clone());
        if self.names.len() >= NAMES_MAX && !self.names.contains_key(&key) {
            self.names.retain(|_, it| it.offers > 0);
        }
        self.names.entry(key.clone()).or_default().offers += 1;
        let before = self.offers.insert(offer, key);
        self.is_closed(before);
    }

    /// The offer is gone; its name keeps what it has counted.
    pub(crate) fn close(&mut self, offer: Whose) {
        let gone = self.offers.remove(&offer);
        self.is_closed(gone);
    }

    /// Counts something of an offer. If it is none, it counts in all only.
    pub(crate) fn count(&mut self, offer: Whose, what: impl Fn(&mut Counts)) {
        what(&mut self.total);
        let key = self.offers.get(&offer);
        if let Some(it) = key.and_then(|key| self.names.get_mut(key)) {
            what(&mut it.counts);
        }
    }

    pub(crate) const fn total(&self) -> Counts {
        self.total
    }

    /// The names that something was counted of, or that are offered.
    pub(crate) fn names(&self) -> impl Iterator<Item = (&Key, Counts)> {
        let is_of_use = |(_, it): &(&Key, &Named)| it.offers > 0 || it.counts != Counts::default();
        let names = self.names.iter().filter(is_of_use);
        names.map(|(key, it)| (key, it.counts))
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
        // The peer's offer 1 is another one, and nothing has the number 7.
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
}
