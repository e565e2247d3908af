//! What stands in the file of a ring and at the end of a slot: values, and the layout.

use super::super::{Status, frame_kind::Carrier};
use crate::{
    Instant, Violation,
    limits::{QOS_MAX, RING_SEGMENTS_MAX, SLOT_HEAD, WINDOW_MAX},
};

/// Nothing: a word that names no message.
pub const EMPTY: u64 = 0;

/// A word that names a message.
//= SM2-RNG-003
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Word {
    /// The number of the segment, below 32,768.
    pub segment: u16,
    /// The slot in it.
    pub slot: u16,
    /// The low half of the message's sequence number.
    pub sequence: u32,
}

impl Word {
    const NAMES: u64 = 1 << 31;

    /// The word of the message with this sequence number in this slot; none if the ring lane has
    /// no number for the segment or the slot.
    #[must_use]
    #[inline]
    pub const fn new(segment: u32, slot: u32, sequence: u64) -> Option<Self> {
        if segment >= RING_SEGMENTS_MAX || slot > u16::MAX as u32 {
            return None;
        }
        Some(Self {
            segment: segment as u16,
            slot: slot as u16,
            sequence: sequence as u32,
        })
    }

    /// Its bits.
    #[must_use]
    #[inline]
    pub const fn to_bits(self) -> u64 {
        let segment = (self.segment as u64) << 16;
        Self::NAMES | self.slot as u64 | segment | (self.sequence as u64) << 32
    }

    /// The message that a word names; none if it is [`EMPTY`].
    ///
    /// # Errors
    /// The bits are neither.
    #[inline]
    pub const fn from_bits(bits: u64) -> Result<Option<Self>, NotAWord> {
        if bits == EMPTY {
            return Ok(None);
        }
        if bits & Self::NAMES == 0 {
            return Err(NotAWord);
        }
        Ok(Some(Self {
            segment: (bits >> 16) as u16 & 0x7fff,
            slot: bits as u16,
            sequence: (bits >> 32) as u32,
        }))
    }
}

/// Bits that are neither [`EMPTY`] nor the word of a message (SM2-RNG-003).
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("not a word of a ring")]
pub struct NotAWord;

/// One of the words of a ring.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum At {
    /// Whether the receiver wants the bell.
    ReceiverParked,
    /// Whether the sender wants it.
    SenderParked,
    /// A message on its way, by index.
    Forward(u32),
    /// A message given back, by index.
    Back(u32),
}

/// Where the words of a ring are.
//= SM2-RNG-002
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RingLayout {
    depth: u16,
    window: u32,
}

impl RingLayout {
    /// Where the forward words begin, in bytes.
    const FORWARD: u64 = 128;
    const LINE: u64 = 64;
    /// What the size of the file is a multiple of, in bytes.
    const UNIT: u64 = 4_096;

    /// A ring of so many forward and back words; none if these are not what a link can have.
    #[must_use]
    pub const fn new(depth: u16, window: u32) -> Option<Self> {
        if depth == 0 || depth > QOS_MAX || window <= depth as u32 || window > WINDOW_MAX {
            return None;
        }
        Some(Self { depth, window })
    }

    /// How many forward words there are.
    #[must_use]
    pub const fn depth(self) -> u16 {
        self.depth
    }

    /// How many back words there are.
    #[must_use]
    pub const fn window(self) -> u32 {
        self.window
    }

    /// Where a word begins, in bytes; none if there is no such word. A multiple of 8.
    #[must_use]
    #[inline]
    pub const fn offset(self, at: At) -> Option<u64> {
        match at {
            At::ReceiverParked => Some(0),
            At::SenderParked => Some(Self::LINE),
            At::Forward(index) if index < self.depth as u32 => {
                Some(Self::FORWARD + 8 * index as u64)
            }
            At::Back(index) if index < self.window => Some(self.back() + 8 * index as u64),
            At::Forward(_) | At::Back(_) => None,
        }
    }

    #[inline]
    const fn back(self) -> u64 {
        (Self::FORWARD + 8 * self.depth as u64).next_multiple_of(Self::LINE)
    }

    /// The size of the file, in bytes.
    #[must_use]
    pub const fn size_bytes(self) -> u64 {
        (self.back() + 8 * self.window as u64).next_multiple_of(Self::UNIT)
    }

    /// The forward word of this message.
    #[inline]
    pub(super) const fn forward(self, sequence: u64) -> At {
        At::Forward((sequence % self.depth as u64) as u32)
    }

    /// The back word of the message that is given back after so many.
    #[inline]
    pub(super) const fn back_word(self, given: u64) -> At {
        At::Back((given % self.window as u64) as u32)
    }
}

/// What stands at the end of a slot.
//= SM2-RNG-004
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SlotHead {
    /// The publisher's count of its publications, or the number of the call.
    pub id: u64,
    /// The moment of publication. Of a request: the deadline, 0 for none.
    pub time: Instant,
    /// The length of the payload, in bytes.
    pub len: u64,
    /// How the call went, of a reply. All others: [`Status::Ok`].
    pub status: Status,
}

impl SlotHead {
    /// Its bytes.
    #[must_use]
    #[inline]
    pub fn to_bytes(self) -> [u8; SLOT_HEAD] {
        let mut bytes = [0; SLOT_HEAD];
        bytes[..8].copy_from_slice(&self.id.to_le_bytes());
        bytes[8..16].copy_from_slice(&self.time.0.to_le_bytes());
        bytes[16..24].copy_from_slice(&self.len.to_le_bytes());
        bytes[24..26].copy_from_slice(&(self.status as u16).to_le_bytes());
        bytes
    }

    /// The head in a copy of the last bytes of a slot with such a message.
    ///
    /// # Errors
    /// [`ReservedNotZero`](crate::ViolationKind::ReservedNotZero), and
    /// [`Malformed`](crate::ViolationKind::Malformed) for a reply's status.
    #[inline]
    pub fn from_bytes(bytes: &[u8; SLOT_HEAD], carrier: Carrier) -> Result<Self, Violation> {
        let ([id, time, len, last, reserved @ ..], []) = bytes.as_chunks::<8>() else {
            return Err(violation!(ReservedNotZero, "SM2-RNG-004"));
        };
        let [low, high, zeros @ ..] = *last;
        let status = u16::from_le_bytes([low, high]);
        let is_else = carrier != Carrier::Reply && status != 0;
        if is_else || zeros != [0; 6] || reserved.iter().any(|it| *it != [0; 8]) {
            return Err(violation!(ReservedNotZero, "SM2-RNG-004"));
        }
        Ok(Self {
            id: u64::from_le_bytes(*id),
            time: Instant(u64::from_le_bytes(*time)),
            len: u64::from_le_bytes(*len),
            status: Status::from_number(status).ok_or(violation!(Malformed, "SM2-RNG-004"))?,
        })
    }
}
