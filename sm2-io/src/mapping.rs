//! Shared mappings of memfds.
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
use std::os::fd::BorrowedFd;
use std::ptr::NonNull;

use nix::libc::c_void;
use nix::sys::mman::{self, MapFlags, MmapAdvise, ProtFlags};

use crate::sync::AtomicU64;

/// What the kernel can map with a single page-table entry on the machines that
/// matter here.
pub(crate) const HUGE_PAGE_BYTES: usize = 2 << 20;

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
    /// when all of them will be read. From 2 MiB on, a mapping starts at a multiple of
    /// 2 MiB where possible. Length 0 maps nothing.
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
    pub fn bytes(&self, start: u64, len: u64) -> Option<&[u8]> {
        let start = usize::try_from(start).ok()?;
        let end = start.checked_add(usize::try_from(len).ok()?)?;
        self.as_slice().get(start..end)
    }

    /// All bytes; the same as [`bytes`](Self::bytes) from 0 to the end.
    #[must_use]
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
    pub const fn as_ptr(&self) -> *const u8 {
        self.region.start.as_ptr()
    }

    /// The whole aligned words, which another process may be changing. Only for relaxed
    /// loads: Rust promises no others for read-only memory, and a store would fault.
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

    /// Asks for small pages even where all shared memory gets huge ones: of a large, sparse
    /// file, only what is used shall cost memory.
    pub(crate) fn keep_sparse(&self) {
        // A kernel without huge pages refuses: then there is nothing to ask for.
        let _ = self.region.advise(MmapAdvise::MADV_NOHUGEPAGE);
    }

    /// The whole aligned words, for who shares them with readers all the time.
    pub(crate) fn words(&self) -> &[AtomicU64] {
        self.region.words()
    }

    /// Keeps the mapping out of child processes.
    pub(crate) fn keep_from_children(&self) -> io::Result<()> {
        self.region.advise(MmapAdvise::MADV_DONTFORK)
    }

    pub(crate) const fn as_ptr(&self) -> *mut u8 {
        self.region.start.as_ptr()
    }

    pub(crate) const fn len(&self) -> usize {
        self.region.len
    }
}

/// A range of addresses that this value owns; empty if `len` is 0, and then
/// nothing is mapped.
#[derive(Debug)]
struct Region {
    start: NonNull<u8>,
    len: usize,
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
    };

    fn map(fd: BorrowedFd<'_>, len: u64, prot: ProtFlags, flags: MapFlags) -> io::Result<Self> {
        // A slice may not be longer than `isize::MAX`.
        let len = isize::try_from(len).map_err(|_| io::ErrorKind::InvalidInput)?;
        let Some(size) = NonZeroUsize::new(len.cast_unsigned()) else {
            return Ok(Self::EMPTY);
        };
        let hint = (size.get() >= HUGE_PAGE_BYTES).then(|| Self::aligned_hint(size));
        // SAFETY: without MAP_FIXED the kernel chooses addresses that nothing uses.
        let start = unsafe { mman::mmap(hint.flatten(), size, prot, flags, fd, 0)? };
        Ok(Self {
            start: start.cast(),
            len: size.get(),
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
        };
        let start = room.start.as_ptr().addr();
        NonZeroUsize::new(start.next_multiple_of(HUGE_PAGE_BYTES))
    }

    /// The region as words that may change at any time. Nobody may write through the result
    /// if the region was mapped for reading.
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
        unsafe { mman::madvise(start, self.len, advice)? };
        Ok(())
    }
}

impl Drop for Region {
    fn drop(&mut self) {
        if self.len > 0 {
            // SAFETY: the pages are owned by this value, and every reference into them borrows
            // from it. Fails only for arguments that were never mapped.
            let result = unsafe { mman::munmap(self.start.cast(), self.len) };
            debug_assert_eq!(result, Ok(()));
        }
    }
}
