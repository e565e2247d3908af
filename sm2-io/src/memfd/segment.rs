//! Segments of equal slots that their author reuses.

use std::fs::File;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};

use sm2_proto::Seals;

use super::file::{add_seals, allocate, create};
use crate::huge::{HUGE_LEAST_BYTES, HUGE_PAGE_BYTES, huge_pages_allowed};
use crate::mapping::writable::MappingMut;
use crate::prefetch::prefetch_to_write;

/// A memfd of equal slots that only this value can write to.
///
/// The seals `FUTURE_WRITE|SHRINK|GROW|SEAL` fix the size, and allow other processes to map the file
/// only for reading; the mapping made here before the seals stays writable. Slots start as zeroes.
///
/// The segment does not track which slot is in use, so access to slots is `unsafe`.
/// [`split`](Self::split) makes a safe owner of each slot.
#[derive(Debug)]
pub struct Segment {
    mapping: MappingMut,
    file: File,
    stride: usize,
    slots: u32,
    /// Whether all pages are present.
    present: bool,
}

impl Segment {
    /// Creates a segment of `slots` slots, `stride_bytes` apart.
    ///
    /// From 2 MiB on the mapping starts at a multiple of 2 MiB and asks for huge pages
    /// where [they are allowed](crate::memfd::huge_pages_allowed). A page takes memory once it is
    /// written. A product of 0 makes an empty segment.
    ///
    /// # Errors
    ///
    /// Any error of `memfd_create(2)`, `ftruncate(2)` and `mmap(2)`, such as too many descriptors or
    /// no memory. `InvalidInput` for a size that does not fit the address space.
    pub fn create(stride_bytes: u64, slots: u32) -> io::Result<Self> {
        let stride = usize::try_from(stride_bytes).map_err(|_| io::ErrorKind::InvalidInput)?;
        let len =
            (stride_bytes.checked_mul(u64::from(slots))).ok_or(io::ErrorKind::InvalidInput)?;
        let file = create(c"sm2-segment", len)?;
        let mapping = MappingMut::new(file.as_fd(), len, huge_pages_allowed())?;
        // After mapping: the seals forbid new writable mappings.
        add_seals(&file, Seals::POOLED)?;
        Ok(Self {
            mapping,
            file,
            stride,
            slots,
            present: false,
        })
    }

    /// Makes all pages present, in huge pages where the kernel has them. The first write to a slot then
    /// costs no more than later ones.
    ///
    /// # Errors
    ///
    /// Any error of `madvise(2)` and `fallocate(2)`, such as no memory.
    pub fn prefault(&mut self) -> io::Result<()> {
        self.present = true;
        // Without huge pages, `populate` makes small ones present.
        let _ = self.mapping.gather(0, self.mapping.len());
        match self.mapping.populate() {
            // An older kernel: the pages exist, and page faults map them one by one.
            Err(error) if error.kind() == io::ErrorKind::Unsupported => {
                allocate(&self.file, self.mapping.len())
            }
            result => result,
        }
    }

    /// Makes all pages present and keeps them in memory for as long as this value exists: the kernel
    /// does not swap them out.
    ///
    /// # Errors
    ///
    /// Any error of `mlock(2)`, among them `PermissionDenied` or `OutOfMemory` if
    /// [`locked_bytes_max`](crate::memfd::locked_bytes_max) is too low.
    pub fn lock(&mut self) -> io::Result<()> {
        self.present = true;
        self.mapping.lock()
    }

    /// Whether all pages are present, so that no slot has to be warmed.
    pub(crate) const fn is_present(&self) -> bool {
        self.present
    }

    /// Moves the first `len` bytes of slot `index` into huge pages, as far as that takes no memory for
    /// other slots. For a slot that is about to be written for the first time.
    pub(crate) fn warm(&self, index: u32, len: usize) {
        // The last huge page only if enough of it is needed.
        let whole = (len.min(self.stride) + HUGE_PAGE_BYTES - HUGE_LEAST_BYTES) / HUGE_PAGE_BYTES
            * HUGE_PAGE_BYTES;
        if whole > 0 && self.stride.is_multiple_of(HUGE_PAGE_BYTES) {
            let start = self.stride * index as usize;
            // Without huge pages, small ones work as well.
            let _ = self.mapping.gather(start, start + whole);
        }
    }

    /// Unmaps the last `bytes`, rounded up to a multiple of 2 MiB. Returns whether nothing is left.
    pub(crate) fn unmap_last(&mut self, bytes: usize) -> bool {
        self.mapping.unmap_last(bytes)
    }

    /// The descriptor for receivers.
    #[must_use]
    pub fn fd(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }

    /// The distance from one slot to the next, in bytes; a slot's length.
    #[must_use]
    #[inline]
    pub const fn stride_bytes(&self) -> usize {
        self.stride
    }

    /// How many slots there are.
    #[must_use]
    pub const fn slots(&self) -> u32 {
        self.slots
    }

    /// The length of all slots together, in bytes.
    #[must_use]
    pub const fn len_bytes(&self) -> usize {
        self.mapping.len()
    }

    /// Where slot `index` starts. Valid for reads and writes of
    /// [`stride_bytes`](Self::stride_bytes) bytes while the segment lives.
    ///
    /// # Panics
    ///
    /// If there is no such slot.
    #[must_use]
    #[inline]
    pub fn slot_ptr(&self, index: u32) -> *mut u8 {
        assert!(
            index < self.slots,
            "slot {index} of a segment with {} slots",
            self.slots
        );
        let offset = self.stride * index as usize;
        // SAFETY: the assertion bounds `offset` by (slots - 1) * stride, so it is inside the mapping of
        // slots * stride bytes, or at its end if the stride is 0.
        unsafe { self.mapping.as_ptr().add(offset) }
    }

    /// The first `len` bytes of slot `index`, for writing.
    ///
    /// # Safety
    ///
    /// While the result exists, nothing else may read or write these bytes: no other reference to the
    /// slot in this process, and no receiver that has not released a message in the slot.
    ///
    /// # Panics
    ///
    /// If there is no such slot, or `len` is more than a slot has.
    #[must_use]
    #[allow(
        clippy::mut_from_ref,
        reason = "the caller guarantees that the slot is not shared"
    )]
    #[inline]
    pub unsafe fn slot_mut(&self, index: u32, len: usize) -> &mut [u8] {
        self.check_len(len);
        // SAFETY: `slot_ptr` is valid for a stride, and `check_len` bounds `len` by it; the borrow of
        // `self` keeps the mapping, and the seals of `create` keep the file's size. The caller promises
        // that nothing else uses the bytes.
        unsafe { std::slice::from_raw_parts_mut(self.slot_ptr(index), len) }
    }

    /// The first `len` bytes of slot `index`, for reading.
    ///
    /// # Safety
    ///
    /// While the result exists, nothing may write these bytes. Receivers cannot write, so it is enough
    /// that no [`slot_mut`](Self::slot_mut) of this slot exists.
    ///
    /// # Panics
    ///
    /// If there is no such slot, or `len` is more than a slot has.
    #[must_use]
    #[inline]
    pub unsafe fn slot(&self, index: u32, len: usize) -> &[u8] {
        self.check_len(len);
        // SAFETY: as in `slot_mut`; the caller promises that nothing writes the bytes.
        unsafe { std::slice::from_raw_parts(self.slot_ptr(index), len) }
    }

    /// Prefetches the first and the last cache line of slot `index`, which are about to be written.
    ///
    /// # Panics
    ///
    /// If there is no such slot.
    #[inline]
    pub(crate) fn prefetch_to_write(&self, index: u32) {
        let slot = self.slot_ptr(index);
        prefetch_to_write(slot);
        prefetch_to_write(slot.wrapping_add(self.stride).wrapping_sub(1));
    }

    #[inline]
    fn check_len(&self, len: usize) {
        let stride = self.stride;
        assert!(len <= stride, "{len} bytes of a slot of {stride} bytes");
    }
}
