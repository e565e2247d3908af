//! Slices over the slots of a publisher's pool. Only this file turns memory that another process can write
//! into a Rust reference.

use std::fmt;
use std::ops::Deref;
use std::sync::Arc;

use crate::quota::MappedSegment;

/// The bytes of a message in a slot. Dereferences to them.
pub struct PooledBytes {
    segment: Arc<MappedSegment>,
    /// Inside the mapping, as `new` checked.
    offset: u64,
    len: u64,
}

impl PooledBytes {
    /// Returns the `len` bytes at `offset` of a segment; `None` if the range is not inside the segment.
    ///
    /// # Safety
    ///
    /// A message that was delivered on a link names these bytes, and it is not released before
    /// the result is dropped.
    #[inline]
    pub(crate) unsafe fn new(segment: Arc<MappedSegment>, offset: u64, len: u64) -> Option<Self> {
        segment.range(offset, len)?;
        Some(Self {
            segment,
            offset,
            len,
        })
    }

    /// A private copy of the bytes.
    pub(crate) fn copy(&self) -> Vec<u8> {
        let copy = self.segment.copy_to_vec(self.offset, self.len);
        copy.expect("`new` checked the range; a mapping keeps its size")
    }
}

impl Deref for PooledBytes {
    type Target = [u8];

    #[inline]
    fn deref(&self) -> &[u8] {
        let bytes = self.segment.range(self.offset, self.len);
        let bytes = bytes.expect("`new` checked the range; a mapping keeps its size");
        // SAFETY: the range is inside a mapping that lives as long as `self`, of a file that
        // cannot shrink (`PooledFile`), so it is readable. That the bytes do not change rests on
        // two facts:
        //
        // - Only the author of the segment has a writable mapping (F_SEAL_FUTURE_WRITE, which
        //   `PooledFile` proves), and SM2-PAY-005 forbids the author to write to the slot before
        //   every receiver has released the message; SM2-OPN-008 extends that beyond the end of
        //   the link. The caller of `new` promised that this receiver has not released it.
        // - An author that breaks SPEC runs as the same user: links between users are sealed
        //   unless the operator waives it (SECURITY.md, "The boundary is the user"). Such a
        //   process could as well write to this one's memory by ptrace, so it is inside the
        //   trusted boundary. As a second line of defence the crate reads slots in place only as
        //   types for which every bit pattern is valid (`Plain`), and takes no length or index
        //   from them (SM2-PAY-006).
        unsafe { bytes.as_ref() }
    }
}

impl fmt::Debug for PooledBytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PooledBytes({} bytes)", self.len)
    }
}
