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

    /// The number of bytes.
    #[inline]
    pub(crate) const fn len(&self) -> usize {
        // It is inside a mapping, so it is a length of this machine.
        self.len as usize
    }

    /// A private copy of the bytes.
    pub(crate) fn copy(&self) -> Vec<u8> {
        let copy = self.segment.copy_to_vec(self.offset, self.len);
        copy.expect("`new` checked the range; a mapping keeps its size")
    }

    /// A private copy of `len` bytes from `start` on; `None` if they are not all inside.
    pub(crate) fn copy_part(&self, start: usize, len: usize) -> Option<Vec<u8>> {
        let start = self.place(start, len)?;
        self.segment.copy_to_vec(start, len as u64)
    }

    /// Copies the bytes from `start` on. Returns false if they are not all inside.
    #[inline]
    pub(crate) fn copy_to(&self, start: usize, to: &mut [u8]) -> bool {
        let start = self.place(start, to.len());
        start.is_some_and(|start| self.segment.copy_to(start, to))
    }

    /// The offset in the segment of `len` bytes from `start` on; `None` if they are not all inside the message.
    #[inline]
    fn place(&self, start: usize, len: usize) -> Option<u64> {
        let end = start.checked_add(len)?;
        (end <= self.len()).then(|| self.offset + start as u64)
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
        //   every receiver has released the message; SM2-OPN-010 extends that beyond the end of
        //   the link. The caller of `new` promised that this receiver has not released it.
        // - An author that breaks SPEC runs as the same user: links between users are sealed
        //   unless the operator waives it (SECURITY.md, "The boundary is the user"). Such a
        //   process could as well write to this one's memory by ptrace, so it is inside the
        //   trusted boundary. As a second line of defence the crate reads slots in place only as
        //   types whose bit patterns are all valid (`Plain`), and takes no length or index
        //   from them (SM2-PAY-006).
        unsafe { bytes.as_ref() }
    }
}

impl fmt::Debug for PooledBytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PooledBytes({} bytes)", self.len)
    }
}
