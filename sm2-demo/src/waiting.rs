//! Waits for descriptors, with or without a node to drive.

use std::{
    os::fd::{AsFd, BorrowedFd},
    time::Duration,
};

use nix::{
    errno::Errno,
    poll::{PollFd, PollFlags, ppoll},
    sys::time::TimeSpec,
};
use sm2_io::clock;
use sm2_node::Node;
use sm2_proto::Instant;

use crate::error::DemoError;

/// Waits until a descriptor is readable or at its end, a signal comes, or `timeout` has passed.
/// Returns for each descriptor whether it is ready.
pub(crate) fn readable(
    fds: &[BorrowedFd<'_>],
    timeout: Option<Duration>,
) -> Result<Vec<bool>, DemoError> {
    let mut entries: Vec<_> = fds
        .iter()
        .map(|&fd| PollFd::new(fd, PollFlags::POLLIN))
        .collect();
    match ppoll(&mut entries, timeout.map(TimeSpec::from_duration), None) {
        Ok(_) => Ok(entries.iter().map(|it| it.any().unwrap_or(true)).collect()),
        Err(Errno::EINTR) => Ok(vec![false; fds.len()]),
        Err(errno) => Err(DemoError::system("wait for the demo")(errno.into())),
    }
}

/// As [`readable`], for `others` and the node, which is driven when it is ready.
pub(crate) fn drive(
    node: &Node,
    others: &[BorrowedFd<'_>],
    until: Option<Instant>,
) -> Result<Vec<bool>, DemoError> {
    let fds = [&[node.as_fd()], others].concat();
    let timeout = until.map(|until| until.since(clock::now()));
    let mut ready = readable(&fds, timeout)?;
    if ready.remove(0) {
        // The background thread may already have done what made the descriptor readable.
        let driven = node.spin_some();
        driven.map_err(DemoError::system("wait for messages"))?;
    }
    Ok(ready)
}

/// Drives the node until `until`; returns true as soon as `stop` is readable.
pub(crate) fn pause(node: &Node, stop: BorrowedFd<'_>, until: Instant) -> Result<bool, DemoError> {
    loop {
        if drive(node, &[stop], Some(until))? == [true] {
            return Ok(true);
        }
        if clock::now() >= until {
            return Ok(false);
        }
    }
}

#[cfg(test)]
mod tests;
