//! The removal of messages that arrive a second time.

use std::collections::BTreeMap;

use sm2_proto::Name;

use crate::Origin;

/// How far behind the newest message of a stream a message may arrive, in messages. A [`Spool`](crate::Spool) has
/// never more messages in flight, so none that arrives for the first time is further behind.
pub const REORDER_MAX: u64 = 1_024;
/// How many streams are remembered. Beyond that, the stream that was silent for longest is forgotten.
const STREAMS_MAX: usize = 16_384;
const WORDS: usize = (REORDER_MAX / 64) as usize;

/// The messages that have arrived, by stream: a topic, the bridge that has sent it, and its epoch.
///
/// | number of the message | [`contains`](Self::contains) |
/// | --- | --- |
/// | greater than all before | false |
/// | less than the greatest by less than [`REORDER_MAX`] | whether it was inserted |
/// | less by more | true |
#[derive(Debug, Default)]
pub struct Duplicates {
    streams: BTreeMap<(Name, Name, u64), Stream>,
    /// How many messages have been inserted.
    inserted: u64,
}

#[derive(Debug)]
struct Stream {
    newest: u64,
    /// Bit `n % REORDER_MAX` is set if message `n` has arrived, for the newest message and those before it.
    seen: [u64; WORDS],
    /// The value of `inserted` at the last message.
    last_used: u64,
}

impl Duplicates {
    /// Whether a message of `topic` has arrived before.
    #[must_use]
    pub fn contains(&self, topic: &Name, origin: &Origin) -> bool {
        let stream = self.streams.get(&key(topic, origin));
        stream.is_some_and(|it| it.contains(origin.number))
    }

    /// Remembers a message of `topic`.
    pub fn insert(&mut self, topic: &Name, origin: &Origin) {
        self.inserted += 1;
        let key = key(topic, origin);
        if let Some(stream) = self.streams.get_mut(&key) {
            stream.last_used = self.inserted;
            stream.insert(origin.number);
            return;
        }
        if self.streams.len() >= STREAMS_MAX {
            let silent = self.streams.iter().min_by_key(|(_, it)| it.last_used);
            if let Some(key) = silent.map(|(key, _)| key.clone()) {
                self.streams.remove(&key);
            }
        }
        let stream = Stream::new(origin.number, self.inserted);
        self.streams.insert(key, stream);
    }
}

fn key(topic: &Name, origin: &Origin) -> (Name, Name, u64) {
    (topic.clone(), origin.bridge.clone(), origin.epoch)
}

impl Stream {
    const fn new(number: u64, last_used: u64) -> Self {
        let mut stream = Self {
            newest: number,
            seen: [0; WORDS],
            last_used,
        };
        stream.set(number);
        stream
    }

    const fn contains(&self, number: u64) -> bool {
        let (word, bit) = Self::place(number);
        number <= self.newest && (self.newest - number >= REORDER_MAX || self.seen[word] & bit != 0)
    }

    const fn insert(&mut self, number: u64) {
        if number > self.newest {
            self.clear_up_to(number);
            self.newest = number;
        }
        if self.newest - number < REORDER_MAX {
            self.set(number);
        }
    }

    /// Forgets the messages whose bits are those of the messages after the newest one, up to `number`.
    const fn clear_up_to(&mut self, number: u64) {
        if number - self.newest >= REORDER_MAX {
            self.seen = [0; WORDS];
            return;
        }
        let mut next = self.newest + 1;
        while next <= number {
            let (word, bit) = Self::place(next);
            self.seen[word] &= !bit;
            next += 1;
        }
    }

    const fn place(number: u64) -> (usize, u64) {
        let index = number % REORDER_MAX;
        ((index / 64) as usize, 1 << (index % 64))
    }

    const fn set(&mut self, number: u64) {
        let (word, bit) = Self::place(number);
        self.seen[word] |= bit;
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use proptest::collection::vec;
    use proptest::prelude::*;

    use super::*;

    fn origin(bridge: &str, epoch: u64, number: u64) -> Origin {
        Origin {
            bridge: Name::new(bridge).unwrap(),
            epoch,
            number,
        }
    }

    /// Inserts a message, and returns whether it was there.
    fn repeats(duplicates: &mut Duplicates, topic: &Name, origin: &Origin) -> bool {
        let has = duplicates.contains(topic, origin);
        duplicates.insert(topic, origin);
        has
    }

    #[test]
    fn streams_are_judged_apart() {
        let (pose, image) = (Name::new("pose").unwrap(), Name::new("image").unwrap());
        let mut duplicates = Duplicates::default();
        assert!(!repeats(&mut duplicates, &pose, &origin("a", 1, 7)));
        assert!(repeats(&mut duplicates, &pose, &origin("a", 1, 7)));
        assert!(!repeats(&mut duplicates, &image, &origin("a", 1, 7)));
        assert!(!repeats(&mut duplicates, &pose, &origin("b", 1, 7)));
        assert!(!repeats(&mut duplicates, &pose, &origin("a", 2, 7)));
    }

    #[test]
    fn the_stream_that_was_silent_for_longest_is_forgotten() {
        let topic = Name::new("pose").unwrap();
        let mut duplicates = Duplicates::default();
        for epoch in 0..STREAMS_MAX as u64 {
            duplicates.insert(&topic, &origin("a", epoch, 1));
        }
        assert!(repeats(&mut duplicates, &topic, &origin("a", 0, 1)));
        duplicates.insert(&topic, &origin("b", 0, 1));
        assert_eq!(duplicates.streams.len(), STREAMS_MAX);
        assert!(
            duplicates.contains(&topic, &origin("a", 0, 1)),
            "it was heard last"
        );
        assert!(
            !duplicates.contains(&topic, &origin("a", 1, 1)),
            "it was forgotten"
        );
    }

    proptest! {
        /// The verdicts are those of a set of all messages, as long as none is too far behind.
        #[test]
        fn a_stream_judges_as_a_set_does(
            start in prop_oneof![Just(0), any::<u32>().prop_map(u64::from)],
            steps in vec((0_u64..2_500, 0..REORDER_MAX + 2), 1..300),
        ) {
            let mut stream = Stream::new(start, 0);
            let mut seen = BTreeSet::from([start]);
            for (ahead, behind) in steps {
                let newest = *seen.last().unwrap();
                // Mostly near the newest message, before or after it.
                let number = (newest + ahead / 500).saturating_sub(behind);
                let is_near = newest.saturating_sub(number) < REORDER_MAX;
                let expected = !is_near || !seen.insert(number);
                prop_assert_eq!(stream.contains(number), expected, "{} after {}", number, newest);
                stream.insert(number);
            }
        }
    }
}
