//! Watching a descriptor with a tokio runtime (feature `tokio`).

use std::io;
use std::os::fd::{BorrowedFd, OwnedFd};

use tokio::io::{Interest, unix::AsyncFd};

use crate::syscall::files::duplicate;

/// Registers a duplicate of `fd` with the runtime, which watches whether it is readable. The
/// duplicate stays open for as long as it is watched.
///
/// # Errors
///
/// Any error of `fcntl(2)` and `epoll_ctl(2)`, such as too many descriptors, no memory, or a file that
/// cannot be watched.
///
/// # Panics
///
/// Outside of a tokio runtime with I/O enabled.
pub fn watch_readable(fd: BorrowedFd<'_>) -> io::Result<AsyncFd<OwnedFd>> {
    let fd = duplicate(fd)?;
    // SAFETY: an `OwnedFd` is open and stays the same descriptor until it is dropped, which
    // the `AsyncFd` that owns it does last.
    let watched = unsafe { AsyncFd::register_with_interest(fd, Interest::READABLE) };
    Ok(watched?)
}
