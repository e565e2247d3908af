//! Waiting for several descriptors at a time.

use std::{io, os::fd::BorrowedFd, time::Duration};

use nix::{
    errno::Errno,
    poll::{PollFd, PollFlags, ppoll},
    sys::time::TimeSpec,
};

/// What is waited for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum For {
    /// Something to read, or the end of it.
    Reading,
    /// Only that nobody reads any more what is written here.
    Hangup,
}

/// Waits until one of the descriptors has what is waited for, a signal comes, or `timeout`
/// has passed; which ones have it, in the same order.
///
/// # Errors
///
/// What `ppoll(2)` says: no memory.
pub(crate) fn wait(
    fds: &[(BorrowedFd<'_>, For)],
    timeout: Option<Duration>,
) -> io::Result<Vec<bool>> {
    let entry = |&(fd, what): &(_, For)| match what {
        For::Reading => PollFd::new(fd, PollFlags::POLLIN),
        For::Hangup => PollFd::new(fd, PollFlags::empty()),
    };
    let mut entries: Vec<_> = fds.iter().map(entry).collect();
    match ppoll(&mut entries, timeout.map(TimeSpec::from_duration), None) {
        Ok(_) => Ok(entries.iter().map(has_event).collect()),
        Err(Errno::EINTR) => Ok(vec![false; fds.len()]),
        Err(errno) => Err(errno.into()),
    }
}

fn has_event(entry: &PollFd<'_>) -> bool {
    entry.revents().is_some_and(|events| !events.is_empty())
}
