//! Address ranges: all that this crate asks `mmap(2)` and `madvise(2)` for.

use std::io;
use std::num::NonZeroUsize;
use std::os::fd::BorrowedFd;
use std::ptr::NonNull;

use nix::errno::Errno;
use nix::libc::{self, c_int, c_void};
use nix::sys::mman::{self, MapFlags, MmapAdvise, ProtFlags};

use crate::huge::{self, HUGE_LEAST_BYTES, HUGE_PAGE_BYTES, huge_pages_allowed};
use crate::sync::AtomicU64;

/// The advice that puts a range into huge pages, whatever the setting for page faults. The
/// number is the same on all machines.
const MADV_COLLAPSE: c_int = 25;

/// A range of addresses that this value owns; empty if `len` is 0, and then
/// nothing is mapped.
#[derive(Debug)]
pub(super) struct Region {
    start: NonNull<u8>,
    /// How many bytes may be used.
    len: usize,
    /// How many are mapped: what is beyond `len` is there for the kernel alone.
    mapped: usize,
}

// SAFETY: a region is memory, not tied to the thread that mapped it. It hands out only
// its address; the types around it say what may be done with that.
unsafe impl Send for Region {}
// SAFETY: as above; through a shared reference nothing can be changed.
unsafe impl Sync for Region {}

impl Region {
    const EMPTY: Self = Self {
        start: NonNull::dangling(),
        len: 0,
        mapped: 0,
    };

    /// Large regions take up whole huge pages, where they can; those whose pages are made present
    /// at once begin to be large earlier.
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

    /// From `huge_from` bytes on the region takes up whole huge pages, where it can.
    pub(super) fn map_whole_pages(
        fd: BorrowedFd<'_>,
        len: u64,
        prot: ProtFlags,
        flags: MapFlags,
        huge_from: usize,
    ) -> io::Result<Self> {
        // A slice may not be longer than `isize::MAX`.
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
        // SAFETY: without MAP_FIXED the kernel chooses addresses that nothing uses.
        let start = unsafe { mman::mmap(hint, size, prot, flags, fd, 0)? };
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
        // SAFETY: without MAP_FIXED the kernel chooses addresses that nothing uses.
        let start = unsafe { mman::mmap_anonymous(None, size, prot, MapFlags::MAP_PRIVATE)? };
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

    /// How many bytes may be used.
    #[inline]
    pub(super) const fn len(&self) -> usize {
        self.len
    }

    /// How many bytes are mapped.
    pub(super) const fn mapped_len(&self) -> usize {
        self.mapped
    }

    /// An address, a multiple of 2 MiB, at which `size` bytes were free a moment ago: only
    /// there can the kernel use huge pages. As a hint it cannot do harm: if another
    /// thread is quicker, the kernel chooses another place.
    fn aligned_hint(size: NonZeroUsize) -> Option<NonZeroUsize> {
        let flags = MapFlags::MAP_PRIVATE | MapFlags::MAP_NORESERVE;
        let len = size.checked_add(HUGE_PAGE_BYTES)?;
        // SAFETY: without MAP_FIXED the kernel chooses addresses that nothing uses.
        let start = unsafe { mman::mmap_anonymous(None, len, ProtFlags::PROT_NONE, flags) };
        let room = Self {
            start: start.ok()?.cast(),
            len: len.get(),
            mapped: len.get(),
        };
        let start = room.start.as_ptr().addr();
        NonZeroUsize::new(start.next_multiple_of(HUGE_PAGE_BYTES))
    }

    /// The region as words that may change at any time. Nobody may write through the result
    /// if the region was mapped for reading.
    #[inline]
    pub(super) fn words(&self) -> &[AtomicU64] {
        if self.len == 0 {
            return &[];
        }
        let words = self.start.cast::<AtomicU64>();
        // SAFETY: what `mmap` returns is aligned to a page, and the pages stay mapped while
        // `self` is borrowed; `AtomicU64` has the layout of `u64`, is valid for all bits, and
        // may change under a shared reference.
        unsafe { std::slice::from_raw_parts(words.as_ptr(), self.len / 8) }
    }

    /// Keeps all pages in memory, present or not by now, for as long as the region exists.
    pub(super) fn lock(&self) -> io::Result<()> {
        if self.len == 0 {
            return Ok(());
        }
        // SAFETY: the range is ours. What the bytes are does not change, nor who may use them.
        unsafe { mman::mlock(self.start.cast::<c_void>(), self.len)? };
        Ok(())
    }

    pub(super) fn advise(&self, advice: MmapAdvise) -> io::Result<()> {
        if self.len == 0 {
            return Ok(());
        }
        let start = self.start.cast::<c_void>();
        // SAFETY: the range is ours. The kinds of advice used here change neither the
        // content of the pages nor what this process may do with them.
        unsafe { mman::madvise(start, self.mapped, advice)? };
        Ok(())
    }

    /// Makes the pages from `from` to `to` present and writable.
    pub(super) fn populate(&self, from: usize, to: usize) -> nix::Result<()> {
        assert!(from <= to && to <= self.mapped);
        if from == to {
            return Ok(());
        }
        // SAFETY: the range is inside of ours, so the address is too. What the bytes are does
        // not change: it is as if each page were read and written back by the kernel. Other
        // threads' accesses are not disturbed by that.
        unsafe {
            let start = self.start.add(from).cast::<c_void>();
            mman::madvise(start, to - from, MmapAdvise::MADV_POPULATE_WRITE)
        }
    }

    /// Puts the bytes from `from` to `to`, multiples of 2 MiB, into huge pages. `false`: not all.
    pub(super) fn gather(&self, from: usize, to: usize) -> bool {
        assert!(from <= to && to <= self.mapped);
        let all = if huge_pages_allowed() {
            // Each fault brings one. Beyond the end of the file there is nothing to bring.
            self.populate(from, to.min(self.len)).is_ok()
        } else {
            // A range without any page is none that the kernel would collapse.
            let first = |at: usize| self.populate(at, (at + 1).min(self.len)).is_ok();
            (from..to.min(self.len)).step_by(HUGE_PAGE_BYTES).all(first)
                && self.collapse(from, to).is_ok()
        };
        if !all {
            huge::pause();
        }
        all
    }

    fn collapse(&self, from: usize, to: usize) -> io::Result<()> {
        assert!(from <= to && to <= self.mapped);
        // SAFETY: the range is inside of ours, so the address is too. The kernel moves the
        // pages, and whoever has them mapped sees the same bytes at the same addresses.
        let result = unsafe {
            let start = self.start.as_ptr().add(from).cast::<c_void>();
            libc::madvise(start, to - from, MADV_COLLAPSE)
        };
        Errno::result(result).map(drop).map_err(io::Error::from)
    }
}

impl Drop for Region {
    fn drop(&mut self) {
        if self.len > 0 {
            // SAFETY: the pages are owned by this value, and every reference into them borrows
            // from it. Fails only for arguments that were never mapped.
            let result = unsafe { mman::munmap(self.start.cast(), self.mapped) };
            debug_assert_eq!(result, Ok(()));
        }
    }
}
