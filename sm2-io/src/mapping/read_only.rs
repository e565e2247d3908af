//! Read-only mappings of files that other processes made.

use std::io;
use std::ops::Deref;
use std::os::fd::{AsFd, BorrowedFd};
use std::ptr::NonNull;

use crate::mapping::region::Region;
use crate::memfd::verify::{PooledFile, SealedFile};
use crate::prefetch::prefetch_to_read;
use crate::sync::{AtomicU64, Ordering, compiler_fence};
use crate::syscall::files::{self, Whence};
use crate::syscall::memory::{MapFlags, ProtFlags};

/// A mapping of a file that no process can change any more. Dereferences to its bytes; unmapped
/// when dropped.
#[derive(Debug)]
pub struct SealedMapping {
    region: Region,
}

impl SealedMapping {
    /// Maps the first `len` bytes of `file`.
    ///
    /// `populate` asks the kernel to make all pages present now, in one go: good when all of them
    /// will be read. It has no effect if the file has a hole there: the kernel would fill the hole
    /// with new memory, which costs the author of the file nothing.
    ///
    /// From 2 MiB on, or 512 KiB with `populate`, a mapping starts at a multiple of 2 MiB where
    /// possible and takes up whole ones, so that the kernel can map a huge page of the file as one.
    /// Length 0 maps nothing.
    ///
    /// # Errors
    ///
    /// Any error of `mmap(2)`, among them `PermissionDenied` (not opened for reading) and
    /// `OutOfMemory`. `InvalidInput` if the file is shorter than `len`.
    pub fn new(file: &SealedFile, len: u64, populate: bool) -> io::Result<Self> {
        let region = map(file.as_fd(), file.size_bytes(), len, populate)?;
        Ok(Self { region })
    }

    /// All bytes.
    #[must_use]
    #[inline]
    pub const fn as_slice(&self) -> &[u8] {
        // SAFETY: the region is `len` readable bytes and stays mapped while `self` is borrowed.
        // `new` took a `SealedFile`, and only `InspectedFd::into_sealed` makes one: the file has
        // the seals SHRINK, GROW and WRITE, which nobody can remove, and `map` checked that it has
        // `len` bytes. So no process can change these bytes or take them away.
        unsafe { std::slice::from_raw_parts(self.region.as_ptr(), self.region.len()) }
    }
}

impl Deref for SealedMapping {
    type Target = [u8];

    #[inline]
    fn deref(&self) -> &[u8] {
        self.as_slice()
    }
}

/// A mapping of a file that keeps its size while its author writes to it. Unmapped when dropped.
///
/// Gives copies and raw pointers, never a reference: the author can change the bytes at any time.
#[derive(Debug)]
pub struct PooledMapping {
    region: Region,
}

impl PooledMapping {
    /// Maps the first `len` bytes of `file`: see [`SealedMapping::new`].
    ///
    /// # Errors
    ///
    /// As [`SealedMapping::new`].
    pub fn new(file: &PooledFile, len: u64, populate: bool) -> io::Result<Self> {
        let region = map(file.as_fd(), file.size_bytes(), len, populate)?;
        Ok(Self { region })
    }

    /// The length in bytes.
    #[must_use]
    #[inline]
    pub const fn len(&self) -> usize {
        self.region.len()
    }

    /// Whether the length is 0.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.region.len() == 0
    }

    /// The address of `len` bytes from `start` on; `None` if they are not all inside.
    ///
    /// The address is valid for reads as long as the mapping exists. The bytes can change between two
    /// reads, unless the reader knows that the author does not write.
    #[must_use]
    #[inline]
    pub fn range(&self, start: u64, len: u64) -> Option<NonNull<[u8]>> {
        let start = usize::try_from(start).ok()?;
        let len = usize::try_from(len).ok()?;
        let all = NonNull::new(self.region.as_ptr())?;
        part_of(NonNull::slice_from_raw_parts(all, self.len()), start, len)
    }

    /// `N` bytes from `start` on, copied word by word; `None` if they are not all inside, or
    /// `start` or `N` is not a multiple of 8.
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
            // Relaxed: the only ordering that Rust promises for read-only memory. For a slot's
            // head it pairs with the acquire of the word that named the slot (`ring::atomic`).
            bytes.copy_from_slice(&word.load(Ordering::Relaxed).to_ne_bytes());
        }
        Some(copy)
    }

    /// A private copy of `len` bytes from `start` on; `None` if they are not all inside.
    #[must_use]
    pub fn copy_to_vec(&self, start: u64, len: u64) -> Option<Vec<u8>> {
        let bytes = self.range(start, len)?;
        // SAFETY: the mapping exists during the call.
        Some(unsafe { copy_range(bytes) })
    }

    /// Prefetches the cache line at `start`, which is about to be read.
    #[inline]
    pub fn prefetch(&self, start: u64) {
        prefetch_to_read(self.region.as_ptr().wrapping_add(start as usize));
    }

    /// The whole aligned words, which another process may be changing. Only for relaxed loads: Rust
    /// promises no other atomic operation for read-only memory, and a store would fault.
    #[inline]
    pub(crate) fn words(&self) -> &[AtomicU64] {
        self.region.words()
    }
}

/// Maps the first `len` bytes of a file whose size is `size_bytes` for ever.
fn map(fd: BorrowedFd<'_>, size_bytes: u64, len: u64, populate: bool) -> io::Result<Region> {
    if len > size_bytes {
        return Err(io::ErrorKind::InvalidInput.into());
    }
    let mut flags = MapFlags::MAP_SHARED;
    //= SM2-PAY-009
    flags.set(MapFlags::MAP_POPULATE, populate && !has_hole(fd, len));
    //= SM2-PAY-007
    let region = Region::map(fd, len, ProtFlags::PROT_READ, flags)?;
    Ok(region)
}

/// The address of `len` bytes from `start` of a range on; `None` if they are not all inside.
#[must_use]
#[inline]
pub fn part_of(range: NonNull<[u8]>, start: usize, len: usize) -> Option<NonNull<[u8]>> {
    if start.checked_add(len)? > range.len() {
        return None;
    }
    let first = range.cast::<u8>().as_ptr().wrapping_add(start);
    Some(NonNull::slice_from_raw_parts(NonNull::new(first)?, len))
}

/// A private copy of a range of a [`PooledMapping`].
///
/// # Safety
///
/// `range` is a [range](PooledMapping::range), or a part of one, of a mapping that exists during the call.
#[must_use]
pub unsafe fn copy_range(range: NonNull<[u8]>) -> Vec<u8> {
    let mut copy = Vec::<u8>::with_capacity(range.len());
    // SAFETY: the source is inside a mapping, which cannot shrink (`PooledFile`); the destination is new memory of that
    // length, which the copy fills. The author may write meanwhile, in its own address space: then the copy has some of
    // the old bytes and some of the new ones, and any byte is a valid `u8`.
    unsafe {
        let source = range.cast::<u8>().as_ptr();
        std::ptr::copy_nonoverlapping(source, copy.as_mut_ptr(), range.len());
        copy.set_len(range.len());
    }
    // The compiler must not read the source again in place of the copy.
    compiler_fence(Ordering::SeqCst);
    copy
}

/// Copies the bytes from `start` of a range of a [`PooledMapping`]. Returns false if they are not all inside.
///
/// # Safety
///
/// As for [`copy_range`].
#[must_use]
#[inline]
pub unsafe fn copy_from_range(range: NonNull<[u8]>, start: usize, to: &mut [u8]) -> bool {
    let Some(bytes) = part_of(range, start, to.len()) else {
        return false;
    };
    // SAFETY: as in `copy_range`; the destination is memory of this process, of the length of the part, and no
    // part of a mapping that only has addresses.
    unsafe {
        let source = bytes.cast::<u8>().as_ptr();
        std::ptr::copy_nonoverlapping(source, to.as_mut_ptr(), to.len());
    }
    // The compiler must not read the source again in place of the copy.
    compiler_fence(Ordering::SeqCst);
    true
}

/// Whether some of the first `len` bytes of a file have no memory. Moves the position of the open file,
/// which no reader of a mapping uses. A file that does not tell counts as one with holes.
fn has_hole(fd: BorrowedFd<'_>, len: u64) -> bool {
    files::seek(fd, 0, Whence::SeekHole).map_or(true, |hole| hole.cast_unsigned() < len)
}
