//! What the kernel says about a descriptor.

use std::io;
use std::os::fd::BorrowedFd;

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, fcntl};
use nix::sys::stat::{SFlag, fstat};
use nix::sys::statfs::{TMPFS_MAGIC, fstatfs};
use sm2_proto::{FdFacts, Seals};

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
