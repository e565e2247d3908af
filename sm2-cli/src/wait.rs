//! Waiting for several descriptors at a time.

use std::{io, os::fd::BorrowedFd, time::Duration};

use nix::{
    errno::Errno,
    poll::{PollFd, PollFlags, ppoll},
    sys::time::TimeSpec,
};

/// The kind of event that a wait is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum For {
    /// The descriptor can be read, or its other end is closed.
    Reading,
    /// The reader at the other end is gone.
    Hangup,
}

/// Waits until one of the descriptors has its event, a signal comes, or `timeout` has passed. Returns for
/// each descriptor whether it has its event.
///
/// # Errors
///
/// The error of `ppoll(2)`: there is no memory.
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
