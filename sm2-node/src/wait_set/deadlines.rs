//! The deadlines of a wait set.
//!
//! A wait set sleeps until the first of them. A timerfd for each timer would cost three system calls for each tick:
//! read, set, and the longer list of events.

use sm2_proto::Instant;

use super::Key;

/// Deadlines, the latest first. A wait ends at the last one in the list.
///
/// A sorted vector: sets have few deadlines, and changing one allocates nothing once the vector has grown.
#[derive(Debug, Default)]
pub(super) struct Deadlines(Vec<(Instant, Key)>);

impl Deadlines {
    pub(super) fn insert(&mut self, at: Instant, key: Key) {
        let place = self.place(at, key).unwrap_or_else(|place| place);
        self.0.insert(place, (at, key));
    }

    pub(super) fn remove(&mut self, at: Instant, key: Key) {
        if let Ok(place) = self.place(at, key) {
            self.0.remove(place);
        }
    }

    /// Removes the first deadline, if it has passed.
    pub(super) fn pop_passed(&mut self, now: Instant) -> Option<Key> {
        let (_, key) = self.0.pop_if(|(at, _)| *at <= now)?;
        Some(key)
    }

    pub(super) fn first(&self) -> Option<Instant> {
        self.0.last().map(|(at, _)| *at)
    }

    fn place(&self, at: Instant, key: Key) -> Result<usize, usize> {
        self.0.binary_search_by(|entry| (at, key).cmp(entry))
    }
}
