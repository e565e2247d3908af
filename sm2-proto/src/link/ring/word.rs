//! The words in the file of a ring, their layout, and the head at the end of a slot.

use super::super::{Status, frame_kind::Carrier};
use crate::{
    Instant, Violation,
    limits::{QOS_MAX, RING_SEGMENTS_MAX, SLOT_HEAD, WINDOW_MAX},
};

/// The empty word, which names no message.
pub const EMPTY: u64 = 0;

/// A word that names a message.
//= SM2-RNG-003
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Word {
    /// The number of the segment, below 32,768.
    pub segment: u16,
    /// The slot in the segment.
    pub slot: u16,
    /// The low half of the message's sequence number.
    pub sequence: u32,
}

impl Word {
    const NAMES: u64 = 1 << 31;

    /// Creates the word of the message with this sequence number in this slot. `None` if the
    /// segment's or the slot's number is too large for the ring lane.
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

    /// Encodes the word.
    #[must_use]
    #[inline]
    pub const fn to_bits(self) -> u64 {
        let segment = (self.segment as u64) << 16;
        Self::NAMES | self.slot as u64 | segment | (self.sequence as u64) << 32
    }

    /// Decodes a word; `None` if it is [`EMPTY`].
    ///
    /// # Errors
    /// The bits are neither [`EMPTY`] nor the word of a message.
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

/// Names one word of a ring.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum At {
    /// Whether the receiver sleeps and wants DOORBELL.
    ReceiverParked,
    /// Whether the sender sleeps and wants DOORBELL.
    SenderParked,
    /// A message from the sender to the receiver, by index.
    Forward(u32),
    /// A message that the receiver gave back, by index.
    Back(u32),
}

/// The layout of a ring: how many words it has, and their offsets.
//= SM2-RNG-002
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RingLayout {
    depth: u16,
    window: u32,
}

impl RingLayout {
    /// The offset of the forward words, in bytes.
    const FORWARD: u64 = 128;
    /// The size of a cell: a forward word, and the words of its message.
    const CELL: u64 = 128;
    const LINE: u64 = 64;
    /// The size of the file is a multiple of this, in bytes.
    const UNIT: u64 = 4_096;

    /// Creates the layout of a ring with `depth` forward and `window` back words. `None` if no link
    /// can have such a ring.
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

    /// The offset of a word in bytes, a multiple of 8; `None` if there is no such word.
    #[must_use]
    #[inline]
    pub const fn offset(self, at: At) -> Option<u64> {
        match at {
            At::ReceiverParked => Some(0),
            At::SenderParked => Some(Self::LINE),
            At::Forward(index) if index < self.depth as u32 => {
                Some(Self::FORWARD + Self::CELL * index as u64)
            }
            At::Back(index) if index < self.window => Some(self.back() + 8 * index as u64),
            At::Forward(_) | At::Back(_) => None,
        }
    }

    #[inline]
    const fn back(self) -> u64 {
        Self::FORWARD + Self::CELL * self.depth as u64
    }

    /// The size of the file, in bytes.
    #[must_use]
    pub const fn size_bytes(self) -> u64 {
        (self.back() + 8 * self.window as u64).next_multiple_of(Self::UNIT)
    }

    /// The forward word for the message with this sequence number.
    #[inline]
    pub(super) const fn forward(self, sequence: u64) -> At {
        At::Forward(remainder(sequence, self.depth as u32))
    }

    /// The back word for the next message that is given back, after `given` messages.
    #[inline]
    pub(super) const fn back_word(self, given: u64) -> At {
        At::Back(remainder(given, self.window))
    }
}

/// `number % of`. Each message asks for several remainders, and a division takes ten cycles.
#[inline]
const fn remainder(number: u64, of: u32) -> u32 {
    if of & (of - 1) == 0 {
        number as u32 & (of - 1)
    } else {
        (number % of as u64) as u32
    }
}

/// The head of a message, stored in the last bytes of its slot.
//= SM2-RNG-004
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SlotHead {
    /// The publisher's count of its publications, or the number of the call.
    pub id: u64,
    /// The time of publication. For a request: the deadline, or 0 for none.
    pub time: Instant,
    /// The length of the payload, in bytes.
    pub len: u64,
    /// For a reply: the outcome of the call. All others: [`Status::Ok`].
    pub status: Status,
}

impl SlotHead {
    /// Encodes the head.
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

    /// Decodes the head from a copy of the last bytes of a slot.
    ///
    /// # Errors
    /// [`ReservedNotZero`](crate::ViolationKind::ReservedNotZero) if a reserved byte is not zero.
    /// [`Malformed`](crate::ViolationKind::Malformed) if a reply's status is unknown.
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
