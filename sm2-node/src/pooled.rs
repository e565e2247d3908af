//! Slices over the slots of a publisher's pool. Only this file turns memory that another process can write
//! into a Rust reference.

use std::fmt;
use std::ops::Deref;
use std::ptr::NonNull;

use sm2_io::InUse;
use sm2_io::mapping::{copy_from_range, copy_range, part_of};

use crate::driver::CellCopy;
use crate::quota::MappedSegment;

/// The bytes of a message in a slot, or in the copy of a cell. Dereferences to them.
///
/// Another value of the program, which is dropped later, holds the message and its segment.
pub struct PooledBytes(NonNull<[u8]>);

// SAFETY: the bytes are read alone, and `new` says that they stay readable and do not change, in whichever thread.
unsafe impl Send for PooledBytes {}
// SAFETY: as for `Send`.
unsafe impl Sync for PooledBytes {}

impl PooledBytes {
    /// Returns the `len` bytes at `offset` of a segment; `None` if the range is not inside the segment.
    ///
    /// # Safety
    ///
    /// A message that was delivered on a link names these bytes. Before the result is dropped, the message is not
    /// released, and the segment is not unmapped.
    #[inline]
    pub(crate) unsafe fn new(segment: &MappedSegment, offset: u64, len: u64) -> Option<Self> {
        segment.range(offset, len).map(Self)
    }

    /// Returns the bytes of a message that came in a cell.
    ///
    /// # Safety
    ///
    /// The copy is held until the result is dropped.
    #[inline]
    pub(crate) unsafe fn of_copy(copy: &InUse<CellCopy>) -> Self {
        Self(NonNull::from(&*copy.bytes))
    }

    /// The number of bytes.
    #[inline]
    pub(crate) const fn len(&self) -> usize {
        self.0.len()
    }

    /// A private copy of the bytes.
    pub(crate) fn copy(&self) -> Vec<u8> {
        // SAFETY: it is a range of a segment that is not unmapped before `self` is dropped, as the caller of `new`
        // promised.
        unsafe { copy_range(self.0) }
    }

    /// A private copy of `len` bytes from `start` on; `None` if they are not all inside.
    pub(crate) fn copy_part(&self, start: usize, len: usize) -> Option<Vec<u8>> {
        let part = part_of(self.0, start, len)?;
        // SAFETY: as in `copy`, for a part of the range.
        Some(unsafe { copy_range(part) })
    }

    /// Copies the bytes from `start` on. Returns false if they are not all inside.
    #[inline]
    pub(crate) fn copy_to(&self, start: usize, to: &mut [u8]) -> bool {
        // SAFETY: as in `copy`.
        unsafe { copy_from_range(self.0, start, to) }
    }
}

impl Deref for PooledBytes {
    type Target = [u8];

    #[inline]
    fn deref(&self) -> &[u8] {
        // SAFETY: the range is inside a mapping that lives as long as `self`, as the caller of `new`
        // promised, of a file that cannot shrink (`PooledFile`), so it is readable. That the bytes do
        // not change rests on two facts:
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
        unsafe { self.0.as_ref() }
    }
}

impl fmt::Debug for PooledBytes {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PooledBytes({} bytes)", self.len())
    }
}
