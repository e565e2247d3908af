//! The stored messages of an outbox, by their keys.

use super::message::{Forms, Label, StoredMessage};
use super::message_key::MessageKey;

/// Messages, each under its key.
///
/// Free entries are used again, the last freed entry first, in place. Once the table has as many entries as are needed
/// at a time, storing a message does not allocate.
#[derive(Debug, Default)]
pub(super) struct Messages {
    entries: Vec<Entry>,
    free: Vec<u32>,
}

#[derive(Debug, Default)]
struct Entry {
    /// How many times the entry was used, from 1 on.
    generation: u32,
    /// Without a holder, the entry is free.
    message: StoredMessage,
}

impl Entry {
    #[inline]
    const fn has(&self, generation: u32) -> bool {
        self.generation == generation && self.message.holders > 0
    }
}

impl Messages {
    /// Makes room for this many messages at a time.
    pub(super) fn reserve(&mut self, messages: usize) {
        self.entries.reserve(messages);
        self.free.reserve(messages);
    }

    /// Stores a message with one holder, whose forms the caller adds, and returns its key.
    #[inline]
    pub(super) fn insert(&mut self, label: Label) -> (MessageKey, &mut Forms) {
        let index = self.free.pop().unwrap_or_else(|| self.grow());
        let entry = &mut self.entries[index as usize];
        debug_assert!(entry.message.holders == 0 && entry.message.forms.is_empty());
        entry.generation = entry.generation.checked_add(1).unwrap_or(1);
        entry.message.label = label;
        entry.message.holders = 1;
        entry.message.orphaned = false;
        let key = MessageKey {
            generation: entry.generation,
            index,
        };
        (key, &mut entry.message.forms)
    }

    #[cold]
    fn grow(&mut self) -> u32 {
        self.entries.push(Entry::default());
        // Reserves room for all indices, so that `free` does not allocate.
        self.free.reserve(self.entries.len());
        u32::try_from(self.entries.len() - 1).expect("fewer messages than bytes of memory")
    }

    #[inline]
    pub(super) fn get(&self, key: MessageKey) -> Option<&StoredMessage> {
        let MessageKey { generation, index } = key;
        let entry = self.entries.get(index as usize)?;
        entry.has(generation).then_some(&entry.message)
    }

    #[inline]
    pub(super) fn get_mut(&mut self, key: MessageKey) -> Option<&mut StoredMessage> {
        let MessageKey { generation, index } = key;
        let entry = self.entries.get_mut(index as usize)?;
        entry.has(generation).then_some(&mut entry.message)
    }

    /// Removes a holder of a message. If it was the last one, the key names no message any more, and the caller takes
    /// the forms out.
    #[inline]
    pub(super) fn remove_holder(
        &mut self,
        key: MessageKey,
        is_orphaned: bool,
    ) -> Option<&mut StoredMessage> {
        let MessageKey { generation, index } = key;
        let entry = self.entries.get_mut(index as usize)?;
        if !entry.has(generation) {
            return None;
        }
        let message = &mut entry.message;
        message.orphaned |= is_orphaned;
        message.holders -= 1;
        if message.holders > 0 {
            return None;
        }
        self.free.push(index);
        Some(message)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sm2_proto::Instant;

    fn label(id: u64) -> Label {
        Label {
            id,
            time: Instant(0),
            len: 0,
        }
    }

    fn insert(messages: &mut Messages, id: u64) -> MessageKey {
        messages.insert(label(id)).0
    }

    fn id(messages: &Messages, key: MessageKey) -> Option<u64> {
        messages.get(key).map(|it| it.label.id)
    }

    fn remove(messages: &mut Messages, key: MessageKey) -> bool {
        messages.remove_holder(key, false).is_some()
    }

    #[test]
    fn a_key_names_one_message_and_then_nothing() {
        let mut messages = Messages::default();
        let none = MessageKey::from_raw(0);
        assert!(messages.get(none).is_none() && !remove(&mut messages, none));
        let [first, second] = [1, 2].map(|id| insert(&mut messages, id));
        assert!(first != second && first != none && second != none);
        assert_eq!(id(&messages, first), Some(1));
        assert!(remove(&mut messages, first));
        let third = insert(&mut messages, 3);
        assert_ne!(third, first, "the same entry, and another key");
        assert_eq!(messages.entries.len(), 2);
        let unknown = MessageKey {
            index: third.index + 5,
            ..third
        };
        for gone in [none, first, unknown] {
            assert!(messages.get(gone).is_none(), "{gone:?}");
            assert!(messages.get_mut(gone).is_none());
            assert!(!remove(&mut messages, gone));
        }
        assert_eq!(id(&messages, second), Some(2));
        assert_eq!(messages.get_mut(third).unwrap().label.id, 3);
    }

    #[test]
    fn the_last_holder_frees_the_entry() {
        let mut messages = Messages::default();
        let key = insert(&mut messages, 1);
        messages.get_mut(key).unwrap().holders += 1;
        assert!(messages.remove_holder(key, true).is_none());
        assert_eq!(id(&messages, key), Some(1));
        let last = messages.remove_holder(key, false).expect("the last holder");
        assert!(last.orphaned, "one of the holders said so");
        assert!(messages.remove_holder(key, false).is_none(), "only once");
        let again = insert(&mut messages, 2);
        assert!(!messages.get(again).unwrap().orphaned);
    }

    #[test]
    fn nothing_is_allocated_once_there_is_room() {
        let mut messages = Messages::default();
        messages.reserve(8);
        let room = |messages: &Messages| (messages.entries.capacity(), messages.free.capacity());
        let before = room(&messages);
        for _ in 0..3 {
            let keys: Vec<MessageKey> = (0..8).map(|id| insert(&mut messages, id)).collect();
            for (number, key) in keys.into_iter().enumerate() {
                assert_eq!(id(&messages, key), Some(number as u64));
                assert!(remove(&mut messages, key));
            }
        }
        assert_eq!(room(&messages), before);
    }

    #[test]
    fn turns_begin_again_without_a_key_of_zero() {
        let mut messages = Messages::default();
        let key = insert(&mut messages, 1);
        assert!(remove(&mut messages, key));
        messages.entries[0].generation = u32::MAX;
        let again = insert(&mut messages, 2);
        assert_eq!((again.generation, again.index), (1, 0));
        assert_eq!(MessageKey::from_raw(again.to_raw()), again);
    }
}
