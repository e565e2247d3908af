//! Address ranges: mapping, advising, locking, unmapping.

use std::io;
use std::num::NonZeroUsize;
use std::os::fd::BorrowedFd;
use std::ptr::NonNull;

use nix::libc::c_void;

use crate::huge::{self, HUGE_LEAST_BYTES, HUGE_PAGE_BYTES, huge_pages_allowed};
use crate::sync::AtomicU64;
use crate::syscall::memory::{self, MapFlags, MmapAdvise, ProtFlags};

/// A mapped range of addresses that this value owns; nothing is mapped if `len` is 0.
#[derive(Debug)]
pub(super) struct Region {
    start: NonNull<u8>,
    /// The number of usable bytes.
    len: usize,
    /// The number of mapped bytes: those beyond `len` only complete the last huge page.
    mapped: usize,
}

// SAFETY: a mapping belongs to the process, not to the thread that made it. A region gives out its
// address and atomic words; the types around it justify every other access.
unsafe impl Send for Region {}
// SAFETY: as above; a shared reference allows changes through atomic words alone, and `advise` and
// its like are system calls that the kernel serialises.
unsafe impl Sync for Region {}

impl Region {
    const EMPTY: Self = Self {
        // Aligned for `words`.
        start: NonNull::<AtomicU64>::dangling().cast(),
        len: 0,
        mapped: 0,
    };

    /// Maps `fd`. Large regions cover whole huge pages where possible; a populated region counts as
    /// large from a smaller length on.
    pub(super) fn map(
        fd: BorrowedFd<'_>,
        len: u64,
        prot: ProtFlags,
        flags: MapFlags,
    ) -> io::Result<Self> {
        let huge_from = if flags.contains(MapFlags::MAP_POPULATE) {
            HUGE_LEAST_BYTES
        } else {
            HUGE_PAGE_BYTES
        };
        Self::map_whole_pages(fd, len, prot, flags, huge_from)
    }

    /// Maps `fd`. From `huge_from` bytes on the region covers whole huge pages where possible.
    pub(super) fn map_whole_pages(
        fd: BorrowedFd<'_>,
        len: u64,
        prot: ProtFlags,
        flags: MapFlags,
        huge_from: usize,
    ) -> io::Result<Self> {
        // `slice::from_raw_parts` requires at most `isize::MAX` bytes.
        let len = isize::try_from(len).map_err(|_| io::ErrorKind::InvalidInput)?;
        let Some(size) = NonZeroUsize::new(len.cast_unsigned()) else {
            return Ok(Self::EMPTY);
        };
        let len = size.get();
        let whole = (len >= huge_from)
            .then(|| len.checked_next_multiple_of(HUGE_PAGE_BYTES))
            .flatten();
        let size = whole.and_then(NonZeroUsize::new).unwrap_or(size);
        let hint = whole.and_then(|_| Self::aligned_hint(size));
        // SAFETY: without MAP_FIXED the kernel chooses a range that overlaps no mapping, so no memory
        // of this process changes; the hint does not affect that.
        let start = unsafe { memory::map(hint, size, prot, flags, fd)? };
        Ok(Self {
            start: start.cast(),
            len,
            mapped: size.get(),
        })
    }

    /// Private memory of `len` bytes, all zero.
    pub(super) fn private(len: usize) -> io::Result<Self> {
        let size = NonZeroUsize::new(len).ok_or(io::ErrorKind::InvalidInput)?;
        let prot = ProtFlags::PROT_READ | ProtFlags::PROT_WRITE;
        // SAFETY: without MAP_FIXED the kernel chooses a range that overlaps no mapping.
        let start = unsafe { memory::map_anonymous(size, prot, MapFlags::MAP_PRIVATE)? };
        Ok(Self {
            start: start.cast(),
            len,
            mapped: len,
        })
    }

    #[inline]
    pub(super) const fn as_ptr(&self) -> *mut u8 {
        self.start.as_ptr()
    }

    /// The number of usable bytes.
    #[inline]
    pub(super) const fn len(&self) -> usize {
        self.len
    }

    /// The number of mapped bytes.
    pub(super) const fn mapped_len(&self) -> usize {
        self.mapped
    }

    /// A multiple of 2 MiB where `size` bytes of addresses were free just now: the kernel maps huge
    /// pages only there. A hint does no harm: if another thread takes the range first, the kernel
    /// chooses another one.
    fn aligned_hint(size: NonZeroUsize) -> Option<NonZeroUsize> {
        let flags = MapFlags::MAP_PRIVATE | MapFlags::MAP_NORESERVE;
        let len = size.checked_add(HUGE_PAGE_BYTES)?;
        // SAFETY: without MAP_FIXED the kernel chooses a range that overlaps no mapping.
        let start = unsafe { memory::map_anonymous(len, ProtFlags::PROT_NONE, flags) };
        let room = Self {
            start: start.ok()?.cast(),
            len: len.get(),
            mapped: len.get(),
        };
        let start = room.start.as_ptr().addr();
        NonZeroUsize::new(start.next_multiple_of(HUGE_PAGE_BYTES))
    }

    /// The region as words that may change at any time. If the region is mapped for reading, the
    /// caller must not store: that would fault.
    #[inline]
    pub(super) fn words(&self) -> &[AtomicU64] {
        let words = self.start.cast::<AtomicU64>();
        // SAFETY: if the region is empty, the address is aligned, and no word is read. Otherwise, `mmap` returns a
        // page-aligned address, and the pages stay mapped while `self` is borrowed. `AtomicU64` has the layout of
        // `u64`, every bit pattern is valid, and it may change under a shared reference. The file cannot shrink under
        // the region: the callers of `map` are `read_only::map` and `Ring::map`, which take a proof of that, and the
        // makers of files that no other process has yet or that are sealed already.
        unsafe { std::slice::from_raw_parts(words.as_ptr(), self.len / 8) }
    }

    /// Keeps all pages in memory, present or not by now, for as long as the region exists.
    pub(super) fn lock(&self) -> io::Result<()> {
        if self.len == 0 {
            return Ok(());
        }
        // SAFETY: `self` owns the range. Locking changes neither the bytes nor the access rights.
        unsafe { memory::lock(self.start.cast::<c_void>(), self.len)? };
        Ok(())
    }

    pub(super) fn advise(&self, advice: MmapAdvise) -> io::Result<()> {
        if self.len == 0 {
            return Ok(());
        }
        let start = self.start.cast::<c_void>();
        // SAFETY: `self` owns the range. The kinds of advice that callers pass (HUGEPAGE, NOHUGEPAGE,
        // DONTFORK) change neither the bytes nor the access rights of this process.
        unsafe { memory::advise(start, self.mapped, advice)? };
        Ok(())
    }

    /// Makes the pages from `from` to `to` present and writable.
    pub(super) fn populate(&self, from: usize, to: usize) -> nix::Result<()> {
        assert!(from <= to && to <= self.mapped);
        if from == to {
            return Ok(());
        }
        // SAFETY: the assertion keeps the range inside the one that `self` owns. The kernel faults the
        // pages in for writing, which changes no byte and disturbs no access of other threads.
        unsafe {
            let start = self.start.add(from).cast::<c_void>();
            memory::advise(start, to - from, MmapAdvise::MADV_POPULATE_WRITE)
        }
    }

    /// Moves the bytes from `from` to `to`, multiples of 2 MiB, into huge pages. Returns whether all
    /// are in huge pages.
    pub(super) fn gather(&self, from: usize, to: usize) -> bool {
        assert!(from <= to && to <= self.mapped);
        let all = if huge_pages_allowed() {
            // Each fault provides one. Beyond the end of the file there are no pages.
            self.populate(from, to.min(self.len)).is_ok()
        } else {
            // The kernel does not collapse a range without any page.
            let first = |at: usize| self.populate(at, (at + 1).min(self.len)).is_ok();
            (from..to.min(self.len)).step_by(HUGE_PAGE_BYTES).all(first)
                && self.collapse(from, to).is_ok()
        };
        if !all {
            huge::pause();
        }
        all
    }

    /// Unmaps the last `bytes`, rounded up to a multiple of 2 MiB. Returns whether nothing is left.
    pub(super) fn unmap_last(&mut self, bytes: usize) -> bool {
        let left = self.mapped.saturating_sub(bytes) / HUGE_PAGE_BYTES * HUGE_PAGE_BYTES;
        if left < self.mapped {
            // SAFETY: `self` owns the range, and is borrowed exclusively, so nothing refers to it. The call fails only
            // for a range that was never mapped.
            let result = unsafe { memory::unmap(self.start.add(left).cast(), self.mapped - left) };
            debug_assert_eq!(result, Ok(()));
        }
        (self.mapped, self.len) = (left, self.len.min(left));
        left == 0
    }

    fn collapse(&self, from: usize, to: usize) -> io::Result<()> {
        assert!(from <= to && to <= self.mapped);
        // SAFETY: the assertion keeps the range inside the one that `self` owns. The kernel moves the
        // bytes to other pages; all mappings see the same bytes at the same addresses.
        let result = unsafe {
            let start = self.start.add(from).cast::<c_void>();
            memory::collapse(start, to - from)
        };
        result.map_err(io::Error::from)
    }
}

impl Drop for Region {
    fn drop(&mut self) {
        if self.len > 0 {
            // SAFETY: `self` owns the range, and every reference into it borrows from `self` (or from
            // the value that owns `self`), so none is left. The call fails only for a range that was
            // never mapped.
            let result = unsafe { memory::unmap(self.start.cast(), self.mapped) };
            debug_assert_eq!(result, Ok(()));
        }
    }
}
