//! The messages of a ring that the application holds.

use alloc::vec::Vec;

use super::super::Word;

/// The messages that the application holds, in the order in which it took them.
///
/// Mostly there are few messages, and sometimes a thousand that come back in order. In both cases a
/// sequence number is found at the beginning, and a scan compares many places at a time.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Borrowed {
    /// The sequence numbers, in ascending order.
    sequences: Vec<u64>,
    /// The place of each message: the segment in the high half, the slot in the low half.
    places: Vec<u32>,
}

impl Borrowed {
    pub(super) fn with_capacity(most: u16) -> Self {
        Self {
            sequences: Vec::with_capacity(usize::from(most)),
            places: Vec::with_capacity(usize::from(most)),
        }
    }

    #[inline]
    pub(super) const fn len(&self) -> usize {
        self.sequences.len()
    }

    /// Whether the application holds a message in the slot that this word names.
    #[inline]
    pub(super) fn is_at(&self, word: Word) -> bool {
        self.places.contains(&place(word))
    }

    /// Whether the application holds a message in this segment.
    pub(super) fn is_in(&self, segment: u32) -> bool {
        self.places.iter().any(|place| place >> 16 == segment)
    }

    /// Adds the word of a message. Its sequence number is greater than all before.
    #[inline]
    pub(super) fn push(&mut self, sequence: u64, word: Word) {
        debug_assert!(self.sequences.last().is_none_or(|last| *last < sequence));
        debug_assert_eq!(word.sequence, sequence as u32);
        self.sequences.push(sequence);
        self.places.push(place(word));
    }

    /// Removes the word of a message. `None` if the application does not hold the message.
    #[inline]
    pub(super) fn remove(&mut self, sequence: u64) -> Option<Word> {
        let index = match self.sequences.first()? {
            first if *first == sequence => 0,
            _ => self.sequences.binary_search(&sequence).ok()?,
        };
        // The last one is removed without moving others: usually there is one.
        let place = if index + 1 == self.sequences.len() {
            self.sequences.pop();
            self.places.pop()?
        } else {
            self.sequences.remove(index);
            self.places.remove(index)
        };
        Some(Word {
            segment: (place >> 16) as u16,
            slot: place as u16,
            sequence: sequence as u32,
        })
    }
}

#[inline]
const fn place(word: Word) -> u32 {
    (word.segment as u32) << 16 | word.slot as u32
}
