//! Memory that is shared by handing over a descriptor, and the seals on it.

use std::fs::File;
use std::io::{self, IoSlice};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::fs::FileExt;

use nix::errno::Errno;
use nix::fcntl::{FallocateFlags, FcntlArg, SealFlag, fallocate, fcntl};
use nix::libc::{self, off_t};
use nix::sys::memfd::{MFdFlags, memfd_create};
use nix::sys::resource::{Resource, getrlimit};
use nix::sys::stat::{SFlag, fstat};
use nix::sys::statfs::{TMPFS_MAGIC, fstatfs};
use sm2_proto::{FdFacts, Seals};

pub use crate::blank::Blank;
pub use crate::huge::{huge_pages_allowed, huge_pages_allowed_by};
pub use crate::loan::SealedLoan;
pub use crate::segment::Segment;

/// Asks the kernel what `fd` is, before anybody maps it.
///
/// `regular` is only true for a regular file of the kernel's memory file
/// system, as a memfd is. Two kinds of regular files are left out on purpose:
///
/// - those that cannot have seals. They are not even asked for their size, since they may
///   be on a file system (FUSE) whose owner never answers. All facts are zero then.
/// - those of `hugetlbfs`, whose mappings cannot be unmapped by the length of the message.
///
/// # Errors
///
/// Whatever `fstat(2)` says about a memory file: none are expected.
pub fn facts(fd: BorrowedFd<'_>) -> io::Result<FdFacts> {
    let seals = match fcntl(fd, FcntlArg::F_GET_SEALS) {
        Ok(bits) => Seals(bits.cast_unsigned()),
        // EBADF comes for an O_PATH descriptor: a borrowed one is open.
        Err(Errno::EINVAL | Errno::EBADF) => return Ok(FdFacts::default()),
        Err(errno) => return Err(errno.into()),
    };
    // After the seals: only once SHRINK and GROW are set is a size the last one.
    let stat = fstat(fd)?;
    let kind = SFlag::from_bits_truncate(stat.st_mode) & SFlag::S_IFMT;
    Ok(FdFacts {
        regular: kind == SFlag::S_IFREG && fstatfs(fd)?.filesystem_type() == TMPFS_MAGIC,
        size_bytes: u64::try_from(stat.st_size).unwrap_or(0),
        seals,
    })
}

/// A sealed memfd with a copy of `bytes`, made in the way that is fastest here: through a
/// mapping of huge pages if it is large and there are some, else as [`sealed_from_parts`]. The
/// file is as long as `bytes`.
///
/// # Errors
///
/// As [`sealed_from_parts`].
pub fn sealed_from_bytes(bytes: &[u8]) -> io::Result<OwnedFd> {
    match SealedLoan::of_huge_pages(bytes.len())? {
        Some(loan) => loan.filled(bytes),
        None => sealed_from_parts(&[IoSlice::new(bytes)]),
    }
}

/// A sealed memfd with a copy of `parts`, one after the other: nobody can
/// change its bytes or its size any more. No bytes at all is fine.
///
/// # Errors
///
/// Whatever `memfd_create(2)`, `ftruncate(2)` and `pwrite(2)` say: too many
/// descriptors, no memory. `InvalidInput` if the lengths do not add up to a file's size.
pub fn sealed_from_parts(parts: &[IoSlice<'_>]) -> io::Result<OwnedFd> {
    let len = parts
        .iter()
        .try_fold(0_u64, |sum, part| sum.checked_add(part.len() as u64))
        .ok_or(io::ErrorKind::InvalidInput)?;
    let file = create(c"sm2-message", len)?;
    let mut offset = 0;
    for part in parts {
        // Goes on after a short write: the kernel writes at most 2 GiB - 4 KiB at once.
        file.write_all_at(part, offset)?;
        offset += part.len() as u64;
    }
    add_seals(&file, Seals::SEALED)?;
    Ok(file.into())
}

/// How much memory this process may keep from being swapped out, in bytes: `RLIMIT_MEMLOCK`.
/// Without a limit, `u64::MAX`. A process with `CAP_IPC_LOCK` is not bound by it.
///
/// # Errors
///
/// Whatever `getrlimit(2)` says: none are expected.
pub fn locked_bytes_max() -> io::Result<u64> {
    Ok(getrlimit(Resource::RLIMIT_MEMLOCK)?.0)
}

/// A memfd of `len` zeroes that can be sealed.
pub(crate) fn create(name: &std::ffi::CStr, len: u64) -> io::Result<File> {
    let flags = MFdFlags::MFD_CLOEXEC | MFdFlags::MFD_ALLOW_SEALING;
    let not_executable = MFdFlags::from_bits_retain(libc::MFD_NOEXEC_SEAL);
    let fd = match memfd_create(name, flags | not_executable) {
        // Before Linux 6.3.
        Err(Errno::EINVAL) => memfd_create(name, flags),
        result => result,
    }?;
    let file = File::from(fd);
    file.set_len(len)?;
    Ok(file)
}

/// Gives a file all its pages.
pub(crate) fn allocate(file: &File, len: usize) -> io::Result<()> {
    if len == 0 {
        return Ok(());
    }
    let len = off_t::try_from(len).map_err(|_| io::ErrorKind::InvalidInput)?;
    loop {
        // Large files take long, and a signal interrupts it.
        match fallocate(file, FallocateFlags::empty(), 0, len) {
            Err(Errno::EINTR) => {}
            result => return result.map_err(io::Error::from),
        }
    }
}

/// How often a seal is tried that the kernel refuses with `EBUSY`, where there is no other way.
/// Each time it waits up to 150 ms for whoever holds on to pages: compaction, or a tool that
/// walks a process' memory.
const SEAL_TRIES: u32 = 4;

/// Adds `seals` in one step.
pub(crate) fn add_seals(file: impl AsFd, seals: Seals) -> io::Result<()> {
    let mut result = try_seals(&file, seals);
    for _ in 1..SEAL_TRIES {
        match &result {
            Err(error) if error.kind() == io::ErrorKind::ResourceBusy => {}
            _ => break,
        }
        result = try_seals(&file, seals);
    }
    result
}

/// Adds `seals` in one step, unless that is refused for the moment: `ResourceBusy`.
pub(crate) fn try_seals(file: impl AsFd, seals: Seals) -> io::Result<()> {
    let flags = SealFlag::from_bits_retain(seals.0.cast_signed());
    fcntl(file.as_fd(), FcntlArg::F_ADD_SEALS(flags))?;
    Ok(())
}
