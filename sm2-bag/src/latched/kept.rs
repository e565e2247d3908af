//! The latched state that a recorder keeps for its next file.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use crate::error::WriteError;
use crate::repeated::NotRepeated;
use crate::source::Source;
use crate::writer::{BagWriter, MessageTimes};

/// The last messages of each latched publisher that is there.
pub(crate) struct Kept {
    /// By the address of the source, which stays in memory as long as it is here.
    publishers: BTreeMap<usize, Publisher>,
    /// The length of all payloads, in bytes.
    bytes: u64,
    /// The greatest length of all payloads, in bytes.
    most_bytes: u64,
}

struct Publisher {
    source: Arc<Source>,
    /// As many as are latched, the oldest one first.
    messages: VecDeque<Message>,
}

struct Message {
    times: MessageTimes,
    /// `None` if there was no room for it.
    data: Option<Box<[u8]>>,
}

impl Kept {
    /// Nothing yet, and later payloads of at most this length together, in bytes.
    pub(crate) const fn new(most_bytes: u64) -> Self {
        Self {
            publishers: BTreeMap::new(),
            bytes: 0,
            most_bytes,
        }
    }

    /// Keeps a message that was written, and forgets the one that it displaces from the latched messages.
    pub(crate) fn keep(&mut self, source: &Arc<Source>, times: MessageTimes, data: &[u8]) {
        let latched = usize::from(source.offer.latched);
        if latched == 0 {
            return;
        }
        let publisher = self
            .publishers
            .entry(Arc::as_ptr(source).addr())
            .or_insert_with(|| Publisher {
                source: Arc::clone(source),
                messages: VecDeque::new(),
            });
        if publisher.messages.len() == latched
            && let Some(displaced) = publisher.messages.pop_front()
        {
            self.bytes -= displaced.len_bytes();
        }
        let has_room = self.bytes + data.len() as u64 <= self.most_bytes;
        let data = has_room.then(|| data.into());
        let message = Message { times, data };
        self.bytes += message.len_bytes();
        publisher.messages.push_back(message);
    }

    /// Forgets a publisher that has left.
    pub(crate) fn forget(&mut self, source: &Arc<Source>) {
        if let Some(publisher) = self.publishers.remove(&Arc::as_ptr(source).addr()) {
            let lengths = publisher.messages.iter().map(Message::len_bytes);
            self.bytes -= lengths.sum::<u64>();
        }
    }

    /// Begins a bag, at this time, with the latched messages, whose payloads may have `most_bytes` together. The bag
    /// says how many have no room.
    pub(crate) fn repeat(
        &self,
        bag: &mut BagWriter,
        log_time: u64,
        most_bytes: u64,
    ) -> Result<(), WriteError> {
        let mut left_bytes = most_bytes;
        for Publisher { source, messages } in self.publishers.values() {
            let mut not_repeated = 0;
            for Message { times, data } in messages {
                let len_bytes = data.as_ref().map(|it| it.len() as u64);
                match (data, len_bytes.and_then(|it| left_bytes.checked_sub(it))) {
                    (Some(data), Some(left)) => {
                        left_bytes = left;
                        let times = MessageTimes { log_time, ..*times };
                        bag.repeated_message(source, times, data)?;
                    }
                    _ => not_repeated += 1,
                }
            }
            if not_repeated > 0 {
                tracing::warn!(
                    topic = %source.topic,
                    publisher = %source.publisher,
                    "a file begins without {not_repeated} latched messages, which have no room"
                );
                bag.not_repeated(NotRepeated {
                    topic: source.topic.to_string(),
                    publisher: source.publisher.to_string(),
                    data: source.data.name.to_string(),
                    messages: not_repeated,
                })?;
            }
        }
        Ok(())
    }
}

impl Message {
    /// The memory of the payload, in bytes.
    fn len_bytes(&self) -> u64 {
        self.data.as_ref().map_or(0, |it| it.len() as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(sequence: u32) -> MessageTimes {
        MessageTimes {
            sequence,
            log_time: 0,
            publish_time: 0,
        }
    }

    /// The numbers of the messages that are kept, and whether their payloads are.
    fn kept(kept: &Kept) -> Vec<(u32, bool)> {
        let messages = kept.publishers.values().flat_map(|it| &it.messages);
        messages
            .map(|it| (it.times.sequence, it.data.is_some()))
            .collect()
    }

    #[test]
    fn the_last_messages_of_each_latched_publisher_are_kept() {
        let mut all = Kept::new(1_000);
        let (two, none) = (Source::of_test("mapper", 2), Source::of_test("mapper", 0));
        for number in 0..5 {
            all.keep(&two, times(number), &[0; 10]);
            all.keep(&none, times(number), &[0; 10]);
        }
        assert_eq!(kept(&all), [(3, true), (4, true)]);
        assert_eq!(all.bytes, 20);
        all.forget(&two);
        all.forget(&none);
        assert_eq!((kept(&all), all.bytes), (vec![], 0));
    }

    #[test]
    fn payloads_beyond_the_room_are_not_kept() {
        let mut all = Kept::new(20);
        let two = Source::of_test("mapper", 2);
        for (number, len) in [(0, 15), (1, 6), (2, 5), (3, 20)] {
            all.keep(&two, times(number), &vec![0; len]);
        }
        // The second one did not fit beside the first one, which the third one displaced, and the last one fits not
        // beside the third one.
        assert_eq!(kept(&all), [(2, true), (3, false)]);
        assert_eq!(all.bytes, 5);
        all.keep(&two, times(4), &[0; 20]);
        assert_eq!(kept(&all), [(3, false), (4, true)]);
    }
}
