//! Short messages in cells: each forward word and the words behind it are a *cell*, which has room for one message.
//!
//! The receiver of such a message copies it out of the ring and keeps nothing of the sender's, so the message needs no
//! slot, is not given back, and is settled once its word is taken.

use core::fmt;
use core::hash::{Hash, Hasher};
use core::ops::Deref;

use super::super::Status;
use crate::{Instant, limits::CELL_MAX};

/// How many words of a cell follow its forward word: `id`, `time`, and the payload.
pub const CELL_WORDS: usize = HEAD_WORDS + CELL_MAX / 8;

const HEAD_WORDS: usize = 2;

/// A forward word whose message is in its cell.
//= SM2-RNG-003
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CellWord {
    /// The length of the payload in bytes, at most [`CELL_MAX`].
    pub len: u8,
    /// For a reply: the outcome of the call. All others: [`Status::Ok`].
    pub status: Status,
    /// The low half of the message's sequence number.
    pub sequence: u32,
}

impl CellWord {
    const NAMES: u64 = 1 << 30;

    /// Creates the word of a message with this length and sequence number; `None` if the message is too long for a
    /// cell.
    #[must_use]
    #[inline]
    pub const fn new(len: usize, status: Status, sequence: u64) -> Option<Self> {
        if len > CELL_MAX {
            return None;
        }
        Some(Self {
            len: len as u8,
            status,
            sequence: sequence as u32,
        })
    }

    /// Encodes the word.
    #[must_use]
    #[inline]
    pub const fn to_bits(self) -> u64 {
        let status = (self.status as u64) << 8;
        (self.sequence as u64) << 32 | Self::NAMES | status | self.len as u64
    }

    /// Decodes a word; `None` if it is not that of a message in a cell.
    #[must_use]
    #[inline]
    pub fn from_bits(bits: u64) -> Option<Self> {
        let [len, status, high @ ..] = (bits as u32 ^ Self::NAMES as u32).to_le_bytes();
        if high != [0; 2] {
            return None;
        }
        let status = Status::from_number(status.into())?;
        Self::new(len.into(), status, bits >> 32)
    }

    /// How many words of the cell the message takes.
    #[inline]
    pub(super) const fn words(self) -> usize {
        HEAD_WORDS + (self.len as usize).div_ceil(8)
    }
}

/// A short message to send in a cell: see [`Link::send_in_cell`](crate::link::Link::send_in_cell).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CellMessage<'a> {
    /// The same as [`OutboundMessage::id`](crate::link::OutboundMessage::id).
    pub id: u64,
    /// The same as [`OutboundMessage::time`](crate::link::OutboundMessage::time).
    pub time: Instant,
    /// For a reply: the outcome of the call. All others: [`Status::Ok`].
    pub status: Status,
    /// The payload, of at most [`CELL_MAX`] bytes.
    pub bytes: &'a [u8],
}

impl CellMessage<'_> {
    /// The words of the cell. Words that the message does not need are 0.
    #[inline]
    pub(super) fn to_words(self) -> [u64; CELL_WORDS] {
        let mut words = [0; CELL_WORDS];
        let [id, time, payload @ ..] = &mut words;
        (*id, *time) = (self.id, self.time.0);
        let (whole, rest) = self.bytes.as_chunks::<8>();
        for (word, bytes) in payload.iter_mut().zip(whole) {
            *word = u64::from_le_bytes(*bytes);
        }
        if let Some(word) = payload.get_mut(whole.len()) {
            for (number, byte) in rest.iter().enumerate() {
                *word |= u64::from(*byte) << (8 * number);
            }
        }
        words
    }
}

/// The payload of a message that came in a cell. Dereferences to its bytes, which are aligned to 64.
#[derive(Clone)]
#[repr(C, align(64))]
pub struct CellBytes {
    bytes: [u8; CELL_MAX],
    len: u8,
}

/// The payload of a message in a copy of its cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CellView<'a> {
    payload: &'a [u64; CELL_MAX / 8],
    len: u8,
}

impl<'a> CellView<'a> {
    /// The payload of this length in these words. If the length is above [`CELL_MAX`], it is empty.
    #[must_use]
    #[inline]
    pub const fn new(payload: &'a [u64; CELL_MAX / 8], len: u8) -> Self {
        Self { payload, len }
    }

    /// Copies the payload.
    #[must_use]
    #[inline]
    pub fn to_bytes(self) -> CellBytes {
        let mut bytes = CellBytes {
            bytes: [0; CELL_MAX],
            len: 0,
        };
        bytes.fill(self);
        bytes
    }
}

impl CellBytes {
    /// Replaces the bytes by those of another message.
    #[inline]
    pub fn fill(&mut self, cell: CellView<'_>) {
        let bytes = cell.payload.map(u64::to_le_bytes);
        self.bytes.copy_from_slice(bytes.as_flattened());
        self.len = cell.len;
    }
}

impl Deref for CellBytes {
    type Target = [u8];

    #[inline]
    fn deref(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or_default()
    }
}

// The bytes behind the payload have no meaning.
impl PartialEq for CellBytes {
    fn eq(&self, other: &Self) -> bool {
        **self == **other
    }
}

impl Eq for CellBytes {}

impl Hash for CellBytes {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (**self).hash(state);
    }
}

impl fmt::Debug for CellBytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("CellBytes").field(&&**self).finish()
    }
}

#[cfg(test)]
mod tests {
    use alloc::{format, vec::Vec};

    use siphasher::sip::SipHasher24;

    use super::*;

    #[test]
    fn a_message_of_each_length_passes_through_words() {
        let all: Vec<u8> = (1..=CELL_MAX as u8).collect();
        for len in 0..=CELL_MAX {
            let message = CellMessage {
                id: 7,
                time: Instant(9),
                status: Status::Failed,
                bytes: &all[..len],
            };
            let words = message.to_words();
            assert_eq!(words[..HEAD_WORDS], [7, 9]);
            let word = CellWord::new(len, Status::Failed, (5 << 32) + 3).unwrap();
            assert_eq!((word.len, word.sequence), (len as u8, 3));
            assert_eq!(CellWord::from_bits(word.to_bits()), Some(word));
            assert!(words[word.words()..].iter().all(|it| *it == 0));
            let [_, _, payload @ ..] = &words;
            let bytes = CellView::new(payload, word.len).to_bytes();
            assert_eq!(*bytes, all[..len]);
            assert_eq!(bytes.as_ptr() as usize % 64, 0);
        }
        assert_eq!(CellWord::new(CELL_MAX + 1, Status::Ok, 1), None);
    }

    /// The copy of a cell has bytes of older messages behind the payload.
    #[test]
    fn only_the_payload_of_copied_bytes_counts() {
        let copied = |first_word, len| {
            let mut payload = [u64::MAX; CELL_MAX / 8];
            payload[0] = first_word;
            CellView::new(&payload, len).to_bytes()
        };
        let hash = |it: &CellBytes| {
            let mut hasher = SipHasher24::new();
            it.hash(&mut hasher);
            hasher.finish()
        };
        let (bytes, same, longer) = (copied(0x0201, 1), copied(0x0301, 1), copied(0x0201, 2));
        assert_eq!(bytes, same);
        assert_eq!(hash(&bytes), hash(&same));
        assert_ne!(bytes, longer);
        assert_ne!(hash(&bytes), hash(&longer));
        assert_eq!(format!("{longer:?}"), "CellBytes([1, 2])");
    }

    #[test]
    fn no_other_word_names_a_message_in_a_cell() {
        let right = CellWord::new(0, Status::Ok, 1).unwrap().to_bits();
        assert!(CellWord::from_bits(right).is_some());
        for bit in (7..8).chain(10..32) {
            assert_eq!(CellWord::from_bits(right ^ 1 << bit), None, "bit {bit}");
        }
        let too_long = right | (CELL_MAX as u64 + 1);
        assert_eq!(CellWord::from_bits(too_long), None);
        assert_eq!(CellWord::from_bits(0), None);
    }
}
