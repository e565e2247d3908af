//! System calls on files and their names.

use std::fs::{self, DirBuilder, File, Metadata, OpenOptions, Permissions};
use std::io;
use std::num::NonZeroU64;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::os::unix::fs::{DirBuilderExt, FileExt, OpenOptionsExt, PermissionsExt};
use std::path::Path;

use nix::errno::Errno;
use nix::fcntl::{FcntlArg, fcntl};
use nix::libc;
use nix::sys::resource::{Resource, getrlimit, setrlimit};
use nix::sys::stat::{SFlag, fstat, stat};
use nix::sys::statfs::{TMPFS_MAGIC, fstatfs};
use nix::sys::uio::pread;
pub(crate) use nix::unistd::Whence;
use nix::unistd::{ftruncate, lseek};

use super::{Call, guard};

/// Makes another descriptor of the same open file, close-on-exec.
///
/// # Errors
///
/// Any error of `fcntl(2)`: too many descriptors.
pub fn duplicate(fd: impl AsFd) -> io::Result<OwnedFd> {
    guard(Call::Dup)?;
    fd.as_fd().try_clone_to_owned()
}

/// `RLIMIT_NOFILE` of this process.
pub(crate) fn descriptors_max() -> nix::Result<u64> {
    guard(Call::GetLimit)?;
    Ok(getrlimit(Resource::RLIMIT_NOFILE)?.0)
}

/// Raises `RLIMIT_NOFILE` of this process to its hard limit.
pub(crate) fn raise_descriptors_max() -> nix::Result<()> {
    guard(Call::GetLimit)?;
    let (_, hard) = getrlimit(Resource::RLIMIT_NOFILE)?;
    setrlimit(Resource::RLIMIT_NOFILE, hard, hard)
}

/// How many descriptors this process has, where the kernel tells (Linux 6.2 and later, with `/proc`).
pub(crate) fn open_descriptors() -> Option<u64> {
    guard(Call::Stat).ok()?;
    let count = u64::try_from(stat("/proc/self/fd").ok()?.st_size).ok()?;
    // Older kernels say 0.
    NonZeroU64::new(count).map(NonZeroU64::get)
}

/// Whether a descriptor of this process has this number. Only a number without a descriptor makes the call
/// fail, so no test does.
pub(crate) fn is_open(number: libc::c_int) -> bool {
    // SAFETY: the call reads the flags of a descriptor, and changes nothing.
    unsafe { libc::fcntl(number, libc::F_GETFD) != -1 }
}

/// Sets the size of a file.
pub(crate) fn set_len(file: &File, len: u64) -> io::Result<()> {
    let len = libc::off_t::try_from(len).map_err(|_| io::ErrorKind::InvalidInput)?;
    loop {
        match guard(Call::Truncate).and_then(|()| ftruncate(file, len)) {
            Err(Errno::EINTR) => {}
            result => return Ok(result?),
        }
    }
}

/// Writes all bytes; the kernel writes at most 2 GiB - 4 KiB at once.
pub(crate) fn write_all_at(file: &File, mut bytes: &[u8], mut at: u64) -> io::Result<()> {
    while !bytes.is_empty() {
        let result = guard(Call::Write).map_err(io::Error::from);
        match result.and_then(|()| file.write_at(bytes, at)) {
            Ok(0) => return Err(io::ErrorKind::WriteZero.into()),
            Ok(count) => {
                bytes = &bytes[count..];
                at += count as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// Reads as many bytes as the buffer has.
pub(crate) fn read_exact_at(file: impl AsFd, mut bytes: &mut [u8], mut at: u64) -> io::Result<()> {
    while !bytes.is_empty() {
        let offset = libc::off_t::try_from(at).map_err(|_| io::ErrorKind::InvalidInput)?;
        match guard(Call::Read).and_then(|()| pread(&file, bytes, offset)) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(count) => {
                bytes = &mut bytes[count..];
                at += count as u64;
            }
            Err(Errno::EINTR) => {}
            Err(errno) => return Err(errno.into()),
        }
    }
    Ok(())
}

pub(crate) fn seek(file: impl AsFd, at: libc::off_t, whence: Whence) -> nix::Result<libc::off_t> {
    guard(Call::Seek)?;
    lseek(file, at, whence)
}

/// The type and the size of an open file.
pub(crate) struct Kind {
    pub(crate) regular: bool,
    pub(crate) size_bytes: u64,
}

pub(crate) fn kind(fd: BorrowedFd<'_>) -> nix::Result<Kind> {
    guard(Call::Stat)?;
    let stat = fstat(fd)?;
    let kind = SFlag::from_bits_truncate(stat.st_mode) & SFlag::S_IFMT;
    Ok(Kind {
        regular: kind == SFlag::S_IFREG,
        size_bytes: u64::try_from(stat.st_size).unwrap_or(0),
    })
}

/// Whether the file is in a tmpfs.
pub(crate) fn is_in_tmpfs(fd: BorrowedFd<'_>) -> nix::Result<bool> {
    guard(Call::Stat)?;
    Ok(fstatfs(fd)?.filesystem_type() == TMPFS_MAGIC)
}

/// Whether the file is open for reading.
pub(crate) fn is_readable(fd: BorrowedFd<'_>) -> nix::Result<bool> {
    guard(Call::FcntlFlags)?;
    let mode = fcntl(fd, FcntlArg::F_GETFL)? & libc::O_ACCMODE;
    Ok(mode != libc::O_WRONLY)
}

/// Opens a lock file, and creates it if it does not exist.
pub(crate) fn open_lock(path: &Path) -> io::Result<File> {
    guard(Call::Open)?;
    OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .mode(0o600)
        .custom_flags(libc::O_NOFOLLOW | libc::O_CLOEXEC)
        .open(path)
}

/// Locks a file or a folder for this process alone, without waiting, until it is closed.
///
/// # Errors
///
/// `WouldBlock` if another process has locked it, and any other error of `flock(2)`.
pub fn lock_file(file: &File) -> io::Result<()> {
    let lock = || {
        guard(Call::FileLock)?;
        flock(file, libc::LOCK_EX | libc::LOCK_NB)
    };
    loop {
        match lock() {
            Err(Errno::EINTR) => {}
            locked => return Ok(locked?),
        }
    }
}

/// Unlocks a file.
pub(crate) fn unlock(file: &File) -> nix::Result<()> {
    guard(Call::FileLock)?;
    flock(file, libc::LOCK_UN)
}

/// `nix::fcntl::Flock` panics if it cannot unlock a file.
fn flock(file: &File, operation: libc::c_int) -> nix::Result<()> {
    // SAFETY: the call takes a descriptor, which is open as long as `file` is borrowed, and touches no memory.
    let done = unsafe { libc::flock(file.as_raw_fd(), operation) };
    Errno::result(done).map(drop)
}

pub(crate) fn metadata_of(file: &File) -> io::Result<Metadata> {
    guard(Call::Stat)?;
    file.metadata()
}

pub(crate) fn metadata(path: &Path) -> io::Result<Metadata> {
    guard(Call::Stat)?;
    fs::metadata(path)
}

pub(crate) fn symlink_metadata(path: &Path) -> io::Result<Metadata> {
    guard(Call::Stat)?;
    fs::symlink_metadata(path)
}

pub(crate) fn remove(path: &Path) -> io::Result<()> {
    guard(Call::Unlink)?;
    fs::remove_file(path)
}

pub(crate) fn rename(from: &Path, to: &Path) -> io::Result<()> {
    guard(Call::Rename)?;
    fs::rename(from, to)
}

pub(crate) fn set_mode(path: &Path, mode: u32) -> io::Result<()> {
    guard(Call::Chmod)?;
    fs::set_permissions(path, Permissions::from_mode(mode))
}

pub(crate) fn create_directory(path: &Path, mode: u32) -> io::Result<()> {
    guard(Call::Mkdir)?;
    DirBuilder::new().mode(mode).create(path)
}

pub(crate) fn read_text(path: &str) -> io::Result<String> {
    guard(Call::Open)?;
    fs::read_to_string(path)
}

/// The effective user of this process.
pub(crate) fn user() -> u32 {
    nix::unistd::geteuid().as_raw()
}
