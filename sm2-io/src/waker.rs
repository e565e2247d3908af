//! Waking an event loop from another thread.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};

use nix::errno::Errno;

use crate::syscall::events::{self, EventFd};

/// An `eventfd`: readable from the first [`wake`](Self::wake) until
/// [`drain`](Self::drain).
///
/// Several wake-ups before a drain count as one.
#[derive(Debug)]
pub struct Waker {
    event: EventFd,
}

impl Waker {
    /// Makes a waker that is not readable.
    ///
    /// # Errors
    ///
    /// Any error of `eventfd(2)`, such as too many descriptors or no memory.
    pub fn new() -> io::Result<Self> {
        let event = events::eventfd()?;
        Ok(Self { event })
    }

    /// Makes the waker readable. Never blocks.
    pub fn wake(&self) {
        // EAGAIN means that the counter is full, so the waker is readable already. An open eventfd
        // reports no other error.
        while self.event.write(1) == Err(Errno::EINTR) {}
    }

    /// Makes the waker unreadable. Returns whether it was readable.
    pub fn drain(&self) -> bool {
        loop {
            match self.event.read() {
                Err(Errno::EINTR) => {}
                result => return result.is_ok(),
            }
        }
    }
}

impl AsFd for Waker {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.event.as_fd()
    }
}
