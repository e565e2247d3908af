//! Shared mappings of memfds, and private memory.
//!
//! # What a reader may rely on
//!
//! Memory that another process can change is not what Rust means by `&[u8]`.
//! So it matters what was mapped, and whoever maps must have asked for
//! [`facts`](crate::memfd::facts) and let the protocol judge them first:
//!
//! - A *sealed* memfd (`SHRINK|GROW|WRITE`) is immutable for everybody, its
//!   author included. A reference into it is as good as one into private memory.
//! - A *pooled* one (`SHRINK|GROW|FUTURE_WRITE`) never faults, and nobody but
//!   its author can write. The author must not write to a slot that is
//!   lent out; one that does so breaks the specification, and readers see bytes
//!   change. They must copy what they decide on before they check it, and
//!   read in place only what is valid for every bit pattern. Whoever cannot
//!   trust the author demands sealed messages.
//! - A file without `SHRINK` can be cut short by its author, and reading past
//!   its new end kills the reader (`SIGBUS`). Never map such a file.

use std::io;
use std::num::NonZeroUsize;
use std::ops::{Deref, DerefMut};
use std::os::fd::BorrowedFd;
use std::ptr::NonNull;

use nix::errno::Errno;
use nix::libc::{self, c_int, c_void};
use nix::sys::mman::{self, MapFlags, MmapAdvise, ProtFlags};

use crate::huge::{self, HUGE_LEAST_BYTES, HUGE_PAGE_BYTES, huge_pages_allowed};
use crate::sync::{AtomicU64, Ordering};

/// The advice that puts a range into huge pages, whatever the setting for page faults. The
/// number is the same on all machines.
const MADV_COLLAPSE: c_int = 25;

/// A read-only, shared mapping. Unmapped when dropped.
///
/// See the [module](self) for what may be mapped.
#[derive(Debug)]
pub struct Mapping {
    region: Region,
}

impl Mapping {
    /// Maps the first `len` bytes of `fd`, which must have that many.
    ///
    /// `populate` asks the kernel to make all pages present now, in one go: good
    /// when all of them will be read. From 2 MiB on, or 512 KiB if it is populated, a mapping
    /// starts at a multiple of 2 MiB where possible, and takes up whole ones: then a huge page of
    /// the file is mapped as one. Length 0 maps nothing.
    ///
    /// # Errors
    ///
    /// Whatever `mmap(2)` says, among them `PermissionDenied` (not opened for
    /// reading), `OutOfMemory`, and `InvalidInput` for a length that does not fit
    /// the address space.
    pub fn read_only(fd: BorrowedFd<'_>, len: u64, populate: bool) -> io::Result<Self> {
        let mut flags = MapFlags::MAP_SHARED;
        flags.set(MapFlags::MAP_POPULATE, populate);
        let region = Region::map(fd, len, ProtFlags::PROT_READ, flags)?;
        Ok(Self { region })
    }

    /// The length in bytes.
    #[must_use]
    #[inline]
    pub const fn len(&self) -> usize {
        self.region.len
    }

    /// Whether the length is 0.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.region.len == 0
    }

    /// `len` bytes from `start` on; `None` if they are not all inside.
    ///
    /// See the [module](self) for when these bytes can be trusted to stay.
    #[must_use]
    #[inline]
    pub fn bytes(&self, start: u64, len: u64) -> Option<&[u8]> {
        let start = usize::try_from(start).ok()?;
        let end = start.checked_add(usize::try_from(len).ok()?)?;
        self.as_slice().get(start..end)
    }

    /// `N` bytes from `start` on, copied word by word, for what another process may be
    /// changing; `None` if they are not all inside, or `start` or `N` is not a multiple of 8.
    #[must_use]
    #[inline]
    pub fn copy<const N: usize>(&self, start: u64) -> Option<[u8; N]> {
        let first = usize::try_from(start).ok()?.checked_div(8)?;
        if !start.is_multiple_of(8) || !N.is_multiple_of(8) {
            return None;
        }
        let words = self.words().get(first..first.checked_add(N / 8)?)?;
        let mut copy = [0; N];
        for (bytes, word) in copy.chunks_exact_mut(8).zip(words) {
            // Relaxed: the only ordering that Rust promises for read-only memory.
            bytes.copy_from_slice(&word.load(Ordering::Relaxed).to_ne_bytes());
        }
        Some(copy)
    }

    /// Tells the processor that the bytes from `start` on are read soon: a cache line of them.
    #[inline]
    pub fn prefetch(&self, start: u64) {
        #[cfg(target_arch = "x86_64")]
        if let Some(byte) = usize::try_from(start)
            .ok()
            .and_then(|it| self.as_slice().get(it))
        {
            use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
            // SAFETY: it changes no memory and cannot fault; and the byte is inside the mapping.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(byte).cast()) };
        }
    }

    /// All bytes; the same as [`bytes`](Self::bytes) from 0 to the end.
    #[must_use]
    #[inline]
    pub const fn as_slice(&self) -> &[u8] {
        // SAFETY: the region is `len` readable bytes and stays mapped while `self` is
        // borrowed. Nobody in this process writes through it (PROT_READ). That no other
        // process does is what the seals say, which the caller of `read_only` has
        // checked: see the module.
        unsafe { std::slice::from_raw_parts(self.region.start.as_ptr(), self.region.len) }
    }

    /// Where the mapping starts, for reads that make no claim on what other
    /// processes do (volatile, atomic). Dangling if the length is 0.
    #[must_use]
    #[inline]
    pub const fn as_ptr(&self) -> *const u8 {
        self.region.start.as_ptr()
    }

    /// The whole aligned words, which another process may be changing. Only for relaxed
    /// loads: Rust promises no others for read-only memory, and a store would fault.
    #[inline]
    pub(crate) fn words(&self) -> &[AtomicU64] {
        self.region.words()
    }
}

/// A writable, shared mapping. Unmapped when dropped.
#[derive(Debug)]
pub(crate) struct MappingMut {
    region: Region,
}

impl MappingMut {
    /// Maps the first `len` bytes of `fd` for reading and writing.
    ///
    /// With `huge`, asks for huge pages where the mapping is large enough.
    pub(crate) fn new(fd: BorrowedFd<'_>, len: u64, huge: bool) -> io::Result<Self> {
        let prot = ProtFlags::PROT_READ | ProtFlags::PROT_WRITE;
        let region = Region::map(fd, len, prot, MapFlags::MAP_SHARED)?;
        if huge && region.len >= HUGE_PAGE_BYTES {
            // A kernel without huge pages refuses: small pages are as correct.
            let _ = region.advise(MmapAdvise::MADV_HUGEPAGE);
        }
        Ok(Self { region })
    }

    /// Maps a file of `len` bytes for reading and writing, all of it in huge pages, the last one
    /// too even if the file does not fill it. `None`: it is too short for that, or there are no
    /// such pages.
    pub(crate) fn of_huge_pages(fd: BorrowedFd<'_>, len: u64) -> io::Result<Option<Self>> {
        if len < HUGE_LEAST_BYTES as u64 || !huge::may_ask() {
            return Ok(None);
        }
        let prot = ProtFlags::PROT_READ | ProtFlags::PROT_WRITE;
        let flags = MapFlags::MAP_SHARED;
        let region = Region::map_whole_pages(fd, len, prot, flags, HUGE_LEAST_BYTES)?;
        if huge_pages_allowed() {
            let _ = region.advise(MmapAdvise::MADV_HUGEPAGE);
        }
        let huge = region.gather(0, region.mapped);
        Ok(huge.then_some(Self { region }))
    }

    /// Puts the bytes from `start` to `end` into huge pages, as far as these lie within the
    /// mapping, and makes them present. What the bytes are does not change. `false`: not all
    /// are, and some may not be present.
    pub(crate) fn gather(&self, start: usize, end: usize) -> bool {
        let start = start / HUGE_PAGE_BYTES * HUGE_PAGE_BYTES;
        let most = self.region.mapped / HUGE_PAGE_BYTES * HUGE_PAGE_BYTES;
        let end = end.next_multiple_of(HUGE_PAGE_BYTES).min(most);
        start < end && huge::may_ask() && self.region.gather(start, end)
    }

    /// Makes all pages present, in the file and in the page table.
    ///
    /// `Unsupported` before Linux 5.14.
    pub(crate) fn populate(&self) -> io::Result<()> {
        match self.region.populate(0, self.region.len) {
            Err(Errno::EINVAL) => Err(io::ErrorKind::Unsupported.into()),
            result => result.map_err(io::Error::from),
        }
    }

    /// Keeps all pages in memory, present or not by now, for as long as the mapping exists.
    pub(crate) fn lock(&self) -> io::Result<()> {
        if self.region.len == 0 {
            return Ok(());
        }
        // SAFETY: the range is ours. What the bytes are does not change, nor who may use them.
        unsafe { mman::mlock(self.region.start.cast::<c_void>(), self.region.len)? };
        Ok(())
    }

    /// Asks for small pages even where all shared memory gets huge ones: of a large, sparse
    /// file, only what is used shall cost memory.
    pub(crate) fn keep_sparse(&self) {
        // A kernel without huge pages refuses: then there is nothing to ask for.
        let _ = self.region.advise(MmapAdvise::MADV_NOHUGEPAGE);
    }

    /// The whole aligned words, for who shares them with readers all the time.
    #[inline]
    pub(crate) fn words(&self) -> &[AtomicU64] {
        self.region.words()
    }

    /// Keeps the mapping out of child processes.
    pub(crate) fn keep_from_children(&self) -> io::Result<()> {
        self.region.advise(MmapAdvise::MADV_DONTFORK)
    }

    #[inline]
    pub(crate) const fn as_ptr(&self) -> *mut u8 {
        self.region.start.as_ptr()
    }

    #[inline]
    pub(crate) const fn len(&self) -> usize {
        self.region.len
    }
}

/// Private memory, all zero at first, of which only those pages exist that were written: room for what
/// may be long and mostly is not. (An allocator clears what it had used before, and with that makes it
/// exist.) Dereferences to its bytes.
#[derive(Debug)]
pub struct Scratch {
    region: Region,
}

impl Scratch {
    /// So many bytes.
    ///
    /// # Errors
    ///
    /// Whatever `mmap(2)` says: no memory, or `InvalidInput` for a length of 0.
    pub fn new(len: usize) -> io::Result<Self> {
        let size = NonZeroUsize::new(len).ok_or(io::ErrorKind::InvalidInput)?;
        let prot = ProtFlags::PROT_READ | ProtFlags::PROT_WRITE;
        // SAFETY: without MAP_FIXED the kernel chooses addresses that nothing uses.
        let start = unsafe { mman::mmap_anonymous(None, size, prot, MapFlags::MAP_PRIVATE)? };
        Ok(Self {
            region: Region {
                start: start.cast(),
                len,
                mapped: len,
            },
        })
    }
}

impl Deref for Scratch {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        // SAFETY: the region is `len` readable bytes, zero or what was written there, and stays
        // mapped while `self` is borrowed. It is private: nobody else writes, and who writes by
        // `deref_mut` has borrowed `self` exclusively.
        unsafe { std::slice::from_raw_parts(self.region.start.as_ptr(), self.region.len) }
    }
}

impl DerefMut for Scratch {
    fn deref_mut(&mut self) -> &mut [u8] {
        // SAFETY: as in `deref`; the bytes are writable, and `self` is borrowed exclusively.
        unsafe { std::slice::from_raw_parts_mut(self.region.start.as_ptr(), self.region.len) }
    }
}

/// A range of addresses that this value owns; empty if `len` is 0, and then
/// nothing is mapped.
#[derive(Debug)]
struct Region {
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
    fn map(fd: BorrowedFd<'_>, len: u64, prot: ProtFlags, flags: MapFlags) -> io::Result<Self> {
        let huge_from = if flags.contains(MapFlags::MAP_POPULATE) {
            HUGE_LEAST_BYTES
        } else {
            HUGE_PAGE_BYTES
        };
        Self::map_whole_pages(fd, len, prot, flags, huge_from)
    }

    /// From `huge_from` bytes on the region takes up whole huge pages, where it can.
    fn map_whole_pages(
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
    fn words(&self) -> &[AtomicU64] {
        if self.len == 0 {
            return &[];
        }
        let words = self.start.cast::<AtomicU64>();
        // SAFETY: what `mmap` returns is aligned to a page, and the pages stay mapped while
        // `self` is borrowed; `AtomicU64` has the layout of `u64`, is valid for all bits, and
        // may change under a shared reference.
        unsafe { std::slice::from_raw_parts(words.as_ptr(), self.len / 8) }
    }

    fn advise(&self, advice: MmapAdvise) -> io::Result<()> {
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
    fn populate(&self, from: usize, to: usize) -> nix::Result<()> {
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
    fn gather(&self, from: usize, to: usize) -> bool {
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
