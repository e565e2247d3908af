//! The sequence numbers of messages: assigned for topics of this domain, compared for topics of
//! others.

use std::collections::BTreeMap;

use sm2_proto::gateway::{GatewayId, Hop, Subject};

/// The least number of topics and origins whose last sequence number is remembered.
const SEEN_LEAST: usize = 16_384;

/// The number of the last message of each topic.
#[derive(Debug, Default)]
pub(super) struct Sequences {
    /// The last number that this gateway gave, by topic of this domain.
    last: BTreeMap<Subject, u64>,
    /// The last message that was taken, by topic and origin.
    seen: BTreeMap<(Subject, GatewayId), Seen>,
}

/// The last message that was taken of a topic and origin.
#[derive(Clone, Copy, Debug, Default)]
struct Seen {
    epoch: u64,
    sequence: u64,
    /// True if the topic was wanted ever since, so that messages in between are missing.
    is_followed: bool,
}

impl Sequences {
    /// The number of topics and origins whose last sequence number is remembered.
    pub(super) fn remembered(&self) -> usize {
        self.seen.len()
    }

    /// The number of the next message of a topic of this domain.
    pub(super) fn next(&mut self, subject: &Subject) -> u64 {
        let last = self.last.entry(subject.clone()).or_insert(0);
        *last += 1;
        *last
    }

    /// Takes a message if it is newer than all that were taken from its origin. Returns how many
    /// messages are missing in between.
    //= SM2-GWM-008
    pub(super) fn take(&mut self, subject: &Subject, origin: Hop, sequence: u64) -> Option<u64> {
        let seen = self.seen.entry((subject.clone(), origin.gateway));
        let last = seen.or_default();
        let epoch = origin.epoch;
        // Another epoch belongs to another process, which numbers its messages from 1. Its epoch is
        // smaller if the clock was set back.
        if epoch == last.epoch && sequence <= last.sequence {
            return None;
        }
        let skipped = match last.is_followed && epoch == last.epoch {
            true => sequence - last.sequence - 1,
            false => 0,
        };
        *last = Seen {
            epoch,
            sequence,
            is_followed: true,
        };
        Some(skipped)
    }

    /// Makes room before a message of `key` is taken: forgets what `is_wanted` denies. Otherwise a
    /// peer could fill the memory with origins that it invents.
    pub(super) fn make_room(
        &mut self,
        key: &(Subject, GatewayId),
        is_wanted: impl Fn(&(Subject, GatewayId)) -> bool,
    ) {
        if self.seen.len() >= SEEN_LEAST && !self.seen.contains_key(key) {
            self.seen.retain(|it, _| is_wanted(it));
        }
    }

    /// A topic is wanted from now on. Messages that its origin published before are not missing.
    pub(super) fn wanted(&mut self, subject: &Subject, origin: GatewayId) {
        if let Some(it) = self.seen.get_mut(&(subject.clone(), origin)) {
            it.is_followed = false;
        }
    }

    /// Forgets a topic, so that messages that were taken before are taken again.
    pub(super) fn forget(&mut self, subject: &Subject, origin: GatewayId) {
        self.seen.remove(&(subject.clone(), origin));
    }
}

#[cfg(test)]
mod tests {
    use sm2_proto::{Name, TypeId};

    use super::*;

    fn key(origin: usize) -> (Subject, GatewayId) {
        let name = Name::new("scan").unwrap();
        let subject = Subject::Topic {
            name: name.clone(),
            data: TypeId { name, hash: 0 },
            reliable: false,
            latched: 0,
        };
        let mut id = [0; 32];
        id[..8].copy_from_slice(&origin.to_le_bytes());
        (subject, GatewayId(id))
    }

    #[test]
    fn origins_that_nobody_wants_are_forgotten_only_when_they_are_too_many() {
        let mut sequences = Sequences::default();
        let take = |sequences: &mut Sequences, (subject, gateway): &(Subject, GatewayId)| {
            let origin = Hop {
                gateway: *gateway,
                epoch: 1,
            };
            sequences.take(subject, origin, 1).is_some()
        };
        for origin in 0..SEEN_LEAST {
            sequences.make_room(&key(origin), |_| false);
            assert!(take(&mut sequences, &key(origin)));
        }
        // A known one needs no room.
        sequences.make_room(&key(0), |_| false);
        assert_eq!(sequences.remembered(), SEEN_LEAST);
        sequences.make_room(&key(SEEN_LEAST), |it| *it == key(7));
        assert_eq!(sequences.remembered(), 1);
        assert!(take(&mut sequences, &key(SEEN_LEAST)));
        assert!(!take(&mut sequences, &key(7)), "a message comes once");
        assert!(take(&mut sequences, &key(8)));
    }

    #[test]
    fn messages_between_two_that_were_taken_are_missing_while_the_topic_is_wanted() {
        let mut sequences = Sequences::default();
        let (subject, gateway) = key(0);
        let origin = |epoch| Hop { gateway, epoch };
        assert_eq!(sequences.take(&subject, origin(1), 5), Some(0));
        assert_eq!(sequences.take(&subject, origin(1), 6), Some(0));
        assert_eq!(sequences.take(&subject, origin(1), 9), Some(2));
        assert_eq!(sequences.take(&subject, origin(1), 9), None);
        sequences.wanted(&subject, gateway);
        assert_eq!(sequences.take(&subject, origin(1), 20), Some(0));
        // Another process numbers its messages anew.
        assert_eq!(sequences.take(&subject, origin(2), 3), Some(0));
        sequences.forget(&subject, gateway);
        assert_eq!(sequences.take(&subject, origin(2), 3), Some(0));
    }
}
