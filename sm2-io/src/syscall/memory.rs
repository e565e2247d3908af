//! System calls on addresses and on memory files.

use std::ffi::CStr;
use std::num::NonZeroUsize;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::ptr::NonNull;

use nix::errno::Errno;
use nix::fcntl::{FallocateFlags, FcntlArg, SealFlag, fallocate, fcntl};
use nix::libc::{self, c_int, c_void};
use nix::sys::memfd::{MFdFlags, memfd_create};
use nix::sys::mman;
pub(crate) use nix::sys::mman::{MapFlags, MmapAdvise, ProtFlags};
use nix::sys::resource::{Resource, getrlimit};

use super::{Call, guard};

/// The advice that moves a range into huge pages, whatever the setting for page faults. The number
/// is the same on all architectures.
const MADV_COLLAPSE: c_int = 25;

/// Maps a file.
///
/// # Safety
///
/// Without `MAP_FIXED` it changes no memory of this process; the caller passes no such flag.
pub(crate) unsafe fn map(
    hint: Option<NonZeroUsize>,
    size: NonZeroUsize,
    prot: ProtFlags,
    flags: MapFlags,
    fd: BorrowedFd<'_>,
) -> nix::Result<NonNull<c_void>> {
    guard(Call::Mmap)?;
    // SAFETY: the caller promises that the flags are without MAP_FIXED.
    unsafe { mman::mmap(hint, size, prot, flags, fd, 0) }
}

/// Maps private memory.
///
/// # Safety
///
/// As [`map`].
pub(crate) unsafe fn map_anonymous(
    size: NonZeroUsize,
    prot: ProtFlags,
    flags: MapFlags,
) -> nix::Result<NonNull<c_void>> {
    guard(Call::Mmap)?;
    // SAFETY: the caller promises that the flags are without MAP_FIXED.
    unsafe { mman::mmap_anonymous(None, size, prot, flags) }
}

/// Gives something back, so no test makes it fail.
///
/// # Safety
///
/// The caller owns the range, and nothing refers to it any more.
pub(crate) unsafe fn unmap(start: NonNull<c_void>, len: usize) -> nix::Result<()> {
    // SAFETY: the caller promises the same.
    unsafe { mman::munmap(start, len) }
}

/// Keeps a range in memory.
///
/// # Safety
///
/// The caller owns the range.
pub(crate) unsafe fn lock(start: NonNull<c_void>, len: usize) -> nix::Result<()> {
    guard(Call::Lock)?;
    // SAFETY: the caller promises the same. Locking changes neither the bytes nor the access rights.
    unsafe { mman::mlock(start, len) }
}

/// Advises the kernel about a range.
///
/// # Safety
///
/// The caller owns the range, and passes no advice that changes bytes or access rights.
pub(crate) unsafe fn advise(
    start: NonNull<c_void>,
    len: usize,
    advice: MmapAdvise,
) -> nix::Result<()> {
    guard(Call::Advise)?;
    // SAFETY: the caller promises the same.
    unsafe { mman::madvise(start, len, advice) }
}

/// Moves a range into huge pages.
///
/// # Safety
///
/// The caller owns the range.
pub(crate) unsafe fn collapse(start: NonNull<c_void>, len: usize) -> nix::Result<()> {
    guard(Call::Advise)?;
    // SAFETY: the caller promises the same. The kernel moves the bytes to other pages; all mappings see the
    // same bytes at the same addresses.
    let result = unsafe { libc::madvise(start.as_ptr(), len, MADV_COLLAPSE) };
    Errno::result(result).map(drop)
}

/// Creates a memfd that can be sealed and, where the kernel knows that, not executed.
pub(crate) fn memfd(name: &CStr) -> nix::Result<OwnedFd> {
    guard(Call::MemfdCreate)?;
    let flags = MFdFlags::MFD_CLOEXEC | MFdFlags::MFD_ALLOW_SEALING;
    let not_executable = MFdFlags::from_bits_retain(libc::MFD_NOEXEC_SEAL);
    match memfd_create(name, flags | not_executable) {
        // Before Linux 6.3.
        Err(Errno::EINVAL) => memfd_create(name, flags),
        result => result,
    }
}

/// Allocates the first `len` bytes of a file.
pub(crate) fn allocate(file: impl AsFd, len: libc::off_t) -> nix::Result<()> {
    guard(Call::Allocate)?;
    fallocate(file, FallocateFlags::empty(), 0, len)
}

/// The bits of the seals of a file.
pub(crate) fn seals(fd: BorrowedFd<'_>) -> nix::Result<u32> {
    guard(Call::GetSeals)?;
    fcntl(fd, FcntlArg::F_GET_SEALS).map(c_int::cast_unsigned)
}

/// Adds seals in one step.
pub(crate) fn add_seals(file: impl AsFd, bits: u32) -> nix::Result<()> {
    guard(Call::AddSeals)?;
    let flags = SealFlag::from_bits_retain(bits.cast_signed());
    fcntl(file.as_fd(), FcntlArg::F_ADD_SEALS(flags)).map(drop)
}

/// `RLIMIT_MEMLOCK` of this process, in bytes.
pub(crate) fn locked_bytes_max() -> nix::Result<u64> {
    guard(Call::GetLimit)?;
    Ok(getrlimit(Resource::RLIMIT_MEMLOCK)?.0)
}
