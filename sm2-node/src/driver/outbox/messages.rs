//! What stands for each message while somebody needs it, by a key.

use super::StoredMessage;

/// Messages, each under the key that it got.
///
/// A key names an entry and how often that was used before, so that a key that is kept for too
/// long names nothing. Entries are reused, the last one first: once there are as many as are needed
/// at a time, nothing is allocated.
#[derive(Debug, Default)]
pub(super) struct Messages {
    entries: Vec<Entry>,
    free: Vec<u32>,
}

#[derive(Debug)]
struct Entry {
    /// How often it was used, from 1 on: no key is 0.
    generation: u32,
    message: Option<StoredMessage>,
}

impl Messages {
    /// Makes room for so many at a time.
    pub(super) fn reserve(&mut self, messages: usize) {
        self.entries.reserve(messages);
        self.free.reserve(messages);
    }

    /// Keeps a message; its key, which is not 0.
    pub(super) fn insert(&mut self, message: StoredMessage) -> u64 {
        let index = self.free.pop().unwrap_or_else(|| {
            self.entries.push(Entry {
                generation: 0,
                message: None,
            });
            // Room for all to come back: then `remove` does not allocate.
            self.free.reserve(self.entries.len());
            u32::try_from(self.entries.len() - 1).expect("fewer messages than bytes of memory")
        });
        let entry = &mut self.entries[index as usize];
        debug_assert!(entry.message.is_none());
        entry.generation = entry.generation.checked_add(1).unwrap_or(1);
        entry.message = Some(message);
        u64::from(entry.generation) << 32 | u64::from(index)
    }

    pub(super) fn get(&self, key: u64) -> Option<&StoredMessage> {
        let (generation, index) = split(key);
        let entry = self.entries.get(index)?;
        entry
            .message
            .as_ref()
            .filter(|_| entry.generation == generation)
    }

    pub(super) fn get_mut(&mut self, key: u64) -> Option<&mut StoredMessage> {
        let (generation, index) = split(key);
        let entry = self.entries.get_mut(index)?;
        entry
            .message
            .as_mut()
            .filter(|_| entry.generation == generation)
    }

    /// Takes a message out; its key names nothing any more.
    pub(super) fn remove(&mut self, key: u64) -> Option<StoredMessage> {
        let (generation, index) = split(key);
        let entry = self.entries.get_mut(index)?;
        let message = entry.message.take_if(|_| entry.generation == generation)?;
        self.free.push(key as u32);
        Some(message)
    }
}

/// How often the entry of a key was used, and the entry.
const fn split(key: u64) -> (u32, usize) {
    ((key >> 32) as u32, key as u32 as usize)
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
        assert!(messages.get(0).is_none() && messages.remove(0).is_none());
        let [first, second] = [1, 2].map(|id| messages.insert(message(id)));
        assert!(first != second && first != 0 && second != 0);
        assert_eq!(messages.remove(first).unwrap().id, 1);
        let third = messages.insert(message(3));
        assert_ne!(third, first, "the same entry, and another key");
        assert_eq!(messages.entries.len(), 2);
        for gone in [0, first, third + 5] {
            assert!(messages.get(gone).is_none(), "{gone:x}");
            assert!(messages.get_mut(gone).is_none());
            assert!(messages.remove(gone).is_none());
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
            let keys: Vec<u64> = (0..8).map(|id| messages.insert(message(id))).collect();
            for (id, key) in keys.into_iter().enumerate() {
                assert_eq!(messages.remove(key).unwrap().id, id as u64);
            }
        }
        assert_eq!(room(&messages), before);
    }

    #[test]
    fn turns_begin_again_without_a_key_of_zero() {
        let mut messages = Messages::default();
        let key = messages.insert(message(1));
        messages.remove(key).unwrap();
        messages.entries[0].generation = u32::MAX;
        assert_eq!(messages.insert(message(2)), 1 << 32);
    }
}
