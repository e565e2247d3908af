//! The kernel's facts about a descriptor.

use std::io;
use std::os::fd::BorrowedFd;

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, fcntl};
use nix::sys::stat::{SFlag, fstat};
use nix::sys::statfs::{TMPFS_MAGIC, fstatfs};
use sm2_proto::{FdFacts, Seals};

/// Asks the kernel about the type, the size and the seals of `fd`.
///
/// `regular` is true only for a regular file of tmpfs, as a memfd is. It is false for two kinds of
/// regular files:
///
/// - files that cannot have seals. All their facts are zero: asking for the size could block, since the
///   file may be on a FUSE file system whose server never answers.
/// - files of `hugetlbfs`, whose mappings cannot be unmapped by the length of the message.
///
/// # Errors
///
/// Any error of `fstat(2)`. None is expected for a memory file.
pub fn facts(fd: BorrowedFd<'_>) -> io::Result<FdFacts> {
    let seals = match fcntl(fd, FcntlArg::F_GET_SEALS) {
        Ok(bits) => Seals(bits.cast_unsigned()),
        // The kernel answers EBADF for an O_PATH descriptor.
        Err(Errno::EINVAL | Errno::EBADF) => return Ok(FdFacts::default()),
        Err(errno) => return Err(errno.into()),
    };
    // After the seals: a size is final only if SHRINK and GROW were set before it was read.
    let stat = fstat(fd)?;
    let kind = SFlag::from_bits_truncate(stat.st_mode) & SFlag::S_IFMT;
    Ok(FdFacts {
        regular: kind == SFlag::S_IFREG && fstatfs(fd)?.filesystem_type() == TMPFS_MAGIC,
        size_bytes: u64::try_from(stat.st_size).unwrap_or(0),
        seals,
    })
}
