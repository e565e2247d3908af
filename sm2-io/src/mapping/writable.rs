//! Writable mappings of files that this process makes, and of rings.

use std::io;
use std::os::fd::BorrowedFd;

use nix::errno::Errno;

use crate::huge::{self, HUGE_LEAST_BYTES, HUGE_PAGE_BYTES, huge_pages_allowed};
use crate::mapping::region::Region;
use crate::sync::AtomicU64;
use crate::syscall::memory::{MapFlags, MmapAdvise, ProtFlags};

/// A writable, shared mapping. Unmapped when dropped.
#[derive(Debug)]
pub(crate) struct MappingMut {
    region: Region,
}

impl MappingMut {
    /// Maps the first `len` bytes of `fd` for reading and writing.
    ///
    /// With `huge`, asks for huge pages if the mapping is large enough.
    pub(crate) fn new(fd: BorrowedFd<'_>, len: u64, huge: bool) -> io::Result<Self> {
        let prot = ProtFlags::PROT_READ | ProtFlags::PROT_WRITE;
        let region = Region::map(fd, len, prot, MapFlags::MAP_SHARED)?;
        if huge && region.len() >= HUGE_PAGE_BYTES {
            // A kernel without huge pages refuses; small pages work as well.
            let _ = region.advise(MmapAdvise::MADV_HUGEPAGE);
        }
        Ok(Self { region })
    }

    /// Maps a file of `len` bytes, at least `HUGE_LEAST_BYTES`, for reading and writing, all in huge pages, also if the
    /// file does not fill the last one. `None` if there are no huge pages.
    pub(crate) fn of_huge_pages(fd: BorrowedFd<'_>, len: u64) -> io::Result<Option<Self>> {
        if !huge::may_ask() {
            return Ok(None);
        }
        let prot = ProtFlags::PROT_READ | ProtFlags::PROT_WRITE;
        let flags = MapFlags::MAP_SHARED;
        let region = Region::map_whole_pages(fd, len, prot, flags, HUGE_LEAST_BYTES)?;
        if huge_pages_allowed() {
            let _ = region.advise(MmapAdvise::MADV_HUGEPAGE);
        }
        let huge = region.gather(0, region.mapped_len());
        Ok(huge.then_some(Self { region }))
    }

    /// Moves the bytes from `start` to `end` into huge pages, as far as these lie within the mapping,
    /// and makes them present; no byte changes. Returns `false` if not all are in huge pages, and then
    /// some may not be present.
    pub(crate) fn gather(&self, start: usize, end: usize) -> bool {
        let start = start / HUGE_PAGE_BYTES * HUGE_PAGE_BYTES;
        let most = self.region.mapped_len() / HUGE_PAGE_BYTES * HUGE_PAGE_BYTES;
        let end = end.next_multiple_of(HUGE_PAGE_BYTES).min(most);
        start < end && huge::may_ask() && self.region.gather(start, end)
    }

    /// Makes all pages present in the file and in the page table.
    ///
    /// `Unsupported` before Linux 5.14.
    pub(crate) fn populate(&self) -> io::Result<()> {
        match self.region.populate(0, self.region.len()) {
            Err(Errno::EINVAL) => Err(io::ErrorKind::Unsupported.into()),
            result => result.map_err(io::Error::from),
        }
    }

    /// Makes all pages present, and keeps them in memory for as long as the mapping exists.
    pub(crate) fn lock(&self) -> io::Result<()> {
        self.region.lock()
    }

    /// Asks for small pages even if all shared memory gets huge ones, so that a large sparse file
    /// takes memory only for the parts that are used.
    pub(crate) fn keep_sparse(&self) {
        // A kernel without huge pages refuses; then all pages are small anyway.
        let _ = self.region.advise(MmapAdvise::MADV_NOHUGEPAGE);
    }

    /// The whole aligned words, which other processes read or write at the same time.
    #[inline]
    pub(crate) fn words(&self) -> &[AtomicU64] {
        self.region.words()
    }

    /// Excludes the mapping from child processes.
    pub(crate) fn keep_from_children(&self) -> io::Result<()> {
        self.region.advise(MmapAdvise::MADV_DONTFORK)
    }

    /// Unmaps the last `bytes`, rounded up to a multiple of 2 MiB. Returns whether nothing is left.
    pub(crate) fn unmap_last(&mut self, bytes: usize) -> bool {
        self.region.unmap_last(bytes)
    }

    #[inline]
    pub(crate) const fn as_ptr(&self) -> *mut u8 {
        self.region.as_ptr()
    }

    #[inline]
    pub(crate) const fn len(&self) -> usize {
        self.region.len()
    }
}
