//! The kernel's facts about a descriptor.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};

use nix::errno::Errno;
use sm2_proto::{FdFacts, Seals};

use crate::syscall::{files, memory};

/// Asks the kernel about the type, the size and the seals of `fd`.
///
/// `regular` is true only for a regular file of tmpfs, as a memfd is, that is open for reading. It is false for these
/// regular files:
///
/// - files that cannot have seals. All their facts are zero: asking for the size could block, since the
///   file may be on a FUSE file system whose server never answers.
/// - files of `hugetlbfs`, whose mappings cannot be unmapped by the length of the message.
/// - files that are open for writing alone, which cannot be mapped.
///
/// # Errors
///
/// Any error of `fstat(2)` and `fcntl(2)`. None is expected for a memory file.
pub fn facts(fd: BorrowedFd<'_>) -> io::Result<FdFacts> {
    let seals = match memory::seals(fd) {
        Ok(bits) => Seals(bits),
        // The kernel answers EBADF for an O_PATH descriptor.
        Err(Errno::EINVAL | Errno::EBADF) => return Ok(FdFacts::default()),
        Err(errno) => return Err(errno.into()),
    };
    // After the seals: a size is final only if SHRINK and GROW were set before it was read.
    let kind = files::kind(fd)?;
    Ok(FdFacts {
        regular: kind.regular && files::is_in_tmpfs(fd)? && files::is_readable(fd)?,
        size_bytes: kind.size_bytes,
        seals,
    })
}

/// Reads as many bytes as `bytes` has, from `offset` of the file on.
///
/// # Errors
///
/// Any error of `pread(2)`, and `UnexpectedEof` if the file is shorter.
pub fn read_exact_at(file: impl AsFd, bytes: &mut [u8], offset: u64) -> io::Result<()> {
    files::read_exact_at(file, bytes, offset)
}
