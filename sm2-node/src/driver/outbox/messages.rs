//! The stored messages of an outbox, by their keys.

use super::message::StoredMessage;
use super::message_key::MessageKey;

/// Messages, each under its key.
///
/// Free entries are used again, the last freed entry first. Once the table has as many entries as
/// are needed at a time, storing a message does not allocate.
#[derive(Debug, Default)]
pub(super) struct Messages {
    entries: Vec<Entry>,
    free: Vec<u32>,
}

#[derive(Debug)]
struct Entry {
    /// How many times the entry was used, from 1 on.
    generation: u32,
    message: Option<StoredMessage>,
}

impl Messages {
    /// Makes room for this many messages at a time.
    pub(super) fn reserve(&mut self, messages: usize) {
        self.entries.reserve(messages);
        self.free.reserve(messages);
    }

    /// Stores a message and returns its key.
    #[inline]
    pub(super) fn insert(&mut self, message: StoredMessage) -> MessageKey {
        let index = self.free.pop().unwrap_or_else(|| {
            self.entries.push(Entry {
                generation: 0,
                message: None,
            });
            // Reserves room for all indices, so that `remove` does not allocate.
            self.free.reserve(self.entries.len());
            u32::try_from(self.entries.len() - 1).expect("fewer messages than bytes of memory")
        });
        let entry = &mut self.entries[index as usize];
        debug_assert!(entry.message.is_none());
        entry.generation = entry.generation.checked_add(1).unwrap_or(1);
        entry.message = Some(message);
        MessageKey {
            generation: entry.generation,
            index,
        }
    }

    #[inline]
    pub(super) fn get(&self, key: MessageKey) -> Option<&StoredMessage> {
        let MessageKey { generation, index } = key;
        let entry = self.entries.get(index as usize)?;
        entry
            .message
            .as_ref()
            .filter(|_| entry.generation == generation)
    }

    #[inline]
    pub(super) fn get_mut(&mut self, key: MessageKey) -> Option<&mut StoredMessage> {
        let MessageKey { generation, index } = key;
        let entry = self.entries.get_mut(index as usize)?;
        entry
            .message
            .as_mut()
            .filter(|_| entry.generation == generation)
    }

    /// Drops a message. Its key then names no message. Returns whether there was one.
    #[inline]
    pub(super) fn remove(&mut self, key: MessageKey) -> bool {
        let MessageKey { generation, index } = key;
        match self.entries.get_mut(index as usize) {
            Some(entry) if entry.generation == generation && entry.message.is_some() => {
                entry.message = None;
                self.free.push(index);
                true
            }
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::driver::Forms;
    use sm2_proto::Instant;

    fn message(id: u64) -> StoredMessage {
        StoredMessage {
            forms: Forms::default(),
            len: 0,
            id,
            time: Instant(0),
            holders: 1,
            orphaned: false,
        }
    }

    #[test]
    fn a_key_names_one_message_and_then_nothing() {
        let mut messages = Messages::default();
        let none = MessageKey::from_raw(0);
        assert!(messages.get(none).is_none() && !messages.remove(none));
        let [first, second] = [1, 2].map(|id| messages.insert(message(id)));
        assert!(first != second && first != none && second != none);
        assert_eq!(messages.get(first).unwrap().id, 1);
        assert!(messages.remove(first));
        let third = messages.insert(message(3));
        assert_ne!(third, first, "the same entry, and another key");
        assert_eq!(messages.entries.len(), 2);
        let unknown = MessageKey {
            index: third.index + 5,
            ..third
        };
        for gone in [none, first, unknown] {
            assert!(messages.get(gone).is_none(), "{gone:?}");
            assert!(messages.get_mut(gone).is_none());
            assert!(!messages.remove(gone));
        }
        assert_eq!(messages.get(second).unwrap().id, 2);
        assert_eq!(messages.get_mut(third).unwrap().id, 3);
    }

    #[test]
    fn nothing_is_allocated_once_there_is_room() {
        let mut messages = Messages::default();
        messages.reserve(8);
        let room = |messages: &Messages| (messages.entries.capacity(), messages.free.capacity());
        let before = room(&messages);
        for _ in 0..3 {
            let keys: Vec<MessageKey> = (0..8).map(|id| messages.insert(message(id))).collect();
            for (id, key) in keys.into_iter().enumerate() {
                assert_eq!(messages.get(key).unwrap().id, id as u64);
                assert!(messages.remove(key));
            }
        }
        assert_eq!(room(&messages), before);
    }

    #[test]
    fn turns_begin_again_without_a_key_of_zero() {
        let mut messages = Messages::default();
        let key = messages.insert(message(1));
        assert!(messages.remove(key));
        messages.entries[0].generation = u32::MAX;
        let again = messages.insert(message(2));
        assert_eq!((again.generation, again.index), (1, 0));
        assert_eq!(MessageKey::from_raw(again.to_raw()), again);
    }
}
