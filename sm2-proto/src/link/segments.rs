//! Checks of descriptors, sizes, strides and slots before anything is mapped.
//!
//! Every address of a payload is computed from values that passed these checks. Only the checks can
//! construct the types in this module, so code that holds such a value need not check again.

use super::RingLayout;
use crate::{
    Clause, FdFacts, Seals, Violation, ViolationKind, clause,
    limits::{MESSAGE_MAX, SEGMENT_BYTES_MAX, SEGMENTS_MAX, SLOT_HEAD, SLOTS_MAX, STRIDE_UNIT},
};

/// The facts about a descriptor that is a regular file with the seals that its use requires.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Verified {
    size_bytes: u64,
}

impl Verified {
    /// Checks the descriptor of one sealed message.
    pub(super) const fn sealed(facts: &FdFacts) -> Result<Self, Violation> {
        Self::with(facts, Seals::SEALED, clause!("SM2-SEG-001"))
    }

    /// Checks the descriptor of a segment of pooled messages.
    pub(super) const fn pooled(facts: &FdFacts) -> Result<Self, Violation> {
        Self::with(facts, Seals::POOLED, clause!("SM2-SEG-001"))
    }

    /// Checks the descriptor of a ring with this depth and window. Returns its layout.
    //= SM2-RNG-002
    pub(super) fn ring(depth: u16, window: u32, fds: &[FdFacts]) -> Result<RingLayout, Violation> {
        let facts = fds.first().ok_or(violation!(FdCount, "SM2-TRN-010"))?;
        let verified = Self::with(facts, Seals::RING, clause!("SM2-RNG-002"))?;
        let cannot_be_written = Seals(Seals::WRITE.0 | Seals::FUTURE_WRITE.0);
        RingLayout::new(depth, window)
            .filter(|layout| {
                facts.seals.0 & cannot_be_written.0 == 0
                    && verified.size_bytes == layout.size_bytes()
            })
            .ok_or(violation!(BadRing, "SM2-RNG-002"))
    }

    /// Checks that the descriptor is a regular file with the `needed` seals, as `clause` requires.
    //= SM2-SEG-001, SM2-RNG-002
    const fn with(facts: &FdFacts, needed: Seals, clause: Clause) -> Result<Self, Violation> {
        if !facts.regular {
            return Err(Violation::new(ViolationKind::NotAMemfd, clause));
        }
        if !facts.seals.contains(needed) {
            return Err(Violation::new(ViolationKind::SealsMissing, clause));
        }
        Ok(Self {
            size_bytes: facts.size_bytes,
        })
    }

    /// Checks that the file can hold a sealed message of this length.
    //= SM2-SEG-002
    pub(super) const fn check_message(self, len: u64) -> Result<(), Violation> {
        if self.size_bytes < len || self.size_bytes > SEGMENT_BYTES_MAX {
            return Err(violation!(BadSize, "SM2-SEG-002"));
        }
        Ok(())
    }

    /// Checks that the file has exactly the size of the segment.
    //= SM2-SEG-003
    pub(super) const fn check_segment(self, geometry: Geometry) -> Result<(), Violation> {
        if self.size_bytes != geometry.size_bytes() {
            return Err(violation!(BadSize, "SM2-SEG-003"));
        }
        Ok(())
    }
}

/// The stride and the number of slots of a segment, within SPEC's limits. No computation with them
/// overflows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Geometry {
    stride: u64,
    slots: u32,
}

impl Geometry {
    /// Returns `None` if the stride, the number of slots or their product is out of range.
    //= SM2-SEG-003
    pub(super) const fn new(stride: u64, slots: u32) -> Option<Self> {
        if stride == 0 || !stride.is_multiple_of(STRIDE_UNIT) || slots == 0 || slots > SLOTS_MAX {
            return None;
        }
        match stride.checked_mul(slots as u64) {
            Some(size) if size <= SEGMENT_BYTES_MAX => Some(Self { stride, slots }),
            _ => None,
        }
    }

    /// The size of a slot in bytes, which is also the length of the longest message on the socket
    /// lane.
    #[inline]
    pub(super) const fn stride(self) -> u64 {
        self.stride
    }

    /// How many slots there are.
    #[inline]
    pub(super) const fn slots(self) -> u32 {
        self.slots
    }

    /// The size of the whole segment, in bytes.
    #[inline]
    pub(super) const fn size_bytes(self) -> u64 {
        self.stride * self.slots as u64
    }

    /// The offset of a slot in bytes. The slot lies entirely within the segment. `None` if there is
    /// no such slot.
    //= SM2-PAY-003
    #[inline]
    pub(super) const fn offset(self, slot: u32) -> Option<u64> {
        if slot < self.slots {
            Some(self.stride * slot as u64)
        } else {
            None
        }
    }
}

/// Checks ATTACH. `is_taken` says whether the segment's number is in use; `count` is how many
/// numbers are in use.
//= SM2-SEG-001, SM2-SEG-003, SM2-SEG-004
pub(super) fn check_attach(
    info: &SegmentInfo,
    fds: &[FdFacts],
    is_taken: bool,
    count: usize,
) -> Result<Geometry, Violation> {
    let verified = Verified::pooled(fds.first().ok_or(violation!(FdCount, "SM2-TRN-010"))?)?;
    if is_taken {
        return Err(violation!(BadSegmentId, "SM2-SEG-003"));
    }
    let geometry =
        Geometry::new(info.stride, info.slots).ok_or(violation!(BadSegment, "SM2-SEG-003"))?;
    verified.check_segment(geometry)?;
    if count >= SEGMENTS_MAX {
        return Err(violation!(SegmentLimit, "SM2-SEG-004"));
    }
    Ok(geometry)
}

/// Whether a message of any form may have this length.
//= SM2-PAY-008
pub(super) const fn is_legal_len(len: u64) -> bool {
    len <= MESSAGE_MAX
}

/// One slot of one segment of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Slot {
    pub(super) segment: u32,
    pub(super) slot: u32,
}

/// The number and shape of a shared segment, which consists of adjacent slots of equal size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SegmentInfo {
    /// Its number on the link.
    pub id: u32,
    /// The size of a slot in bytes: a multiple of 64, not zero.
    pub stride: u64,
    /// The number of slots, 1 to 65,536.
    pub slots: u32,
}

/// A frame about a segment, which a sending end sends over the socket.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum SegmentFrame {
    Attach(SegmentInfo),
    Detach(u32),
}

/// Where a slot is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SlotRange {
    /// The number of the segment.
    pub segment: u32,
    /// The offset of the slot in the segment, in bytes.
    pub offset: u64,
    /// The size of the slot, in bytes.
    pub stride: u64,
}

impl SlotRange {
    /// Where the [head](super::SlotHead) of the slot is in the segment, in bytes.
    #[must_use]
    #[inline]
    pub const fn head_offset(self) -> u64 {
        self.offset + self.stride - SLOT_HEAD as u64
    }
}
