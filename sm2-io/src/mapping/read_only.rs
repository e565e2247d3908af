//! Mappings of what other processes made.

use std::io;
use std::os::fd::BorrowedFd;

use nix::sys::mman::{MapFlags, ProtFlags};

use crate::mapping::region::Region;
use crate::sync::{AtomicU64, Ordering};

/// A read-only, shared mapping. Unmapped when dropped.
///
/// See the [module](super) for what may be mapped.
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
        self.region.len()
    }

    /// Whether the length is 0.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.region.len() == 0
    }

    /// `len` bytes from `start` on; `None` if they are not all inside.
    ///
    /// See the [module](super) for when these bytes can be trusted to stay.
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
        unsafe { std::slice::from_raw_parts(self.region.as_ptr(), self.region.len()) }
    }

    /// Where the mapping starts, for reads that make no claim on what other
    /// processes do (volatile, atomic). Dangling if the length is 0.
    #[must_use]
    #[inline]
    pub const fn as_ptr(&self) -> *const u8 {
        self.region.as_ptr()
    }

    /// The whole aligned words, which another process may be changing. Only for relaxed
    /// loads: Rust promises no others for read-only memory, and a store would fault.
    #[inline]
    pub(crate) fn words(&self) -> &[AtomicU64] {
        self.region.words()
    }
}
