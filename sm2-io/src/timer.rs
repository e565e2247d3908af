//! Waking an event loop at a given time.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use nix::errno::Errno;
use sm2_proto::Instant;

use crate::syscall::events::{self, TimerFd};

/// A `timerfd` on the clock of [`now`](crate::clock::now): readable from the time that it is
/// [set](Self::set) to, until [`drain`](Self::drain) or the next `set`.
///
/// Lets a program whose event loop takes no deadline watch one descriptor instead. Close-on-exec,
/// non-blocking.
#[derive(Debug)]
pub struct Timer {
    timer: TimerFd,
}

impl Timer {
    /// Makes a timer that is not set.
    ///
    /// # Errors
    ///
    /// Any error of `timerfd_create(2)`, such as too many descriptors or no memory.
    pub fn new() -> io::Result<Self> {
        let timer = events::timer()?;
        Ok(Self { timer })
    }

    /// Sets the time when the timer becomes readable, in place of any earlier setting; `None`
    /// clears it. A time in the past makes the timer readable at once.
    ///
    /// # Errors
    ///
    /// None are expected of a timer that exists.
    pub fn set(&self, at: Option<Instant>) -> io::Result<()> {
        // Zero would clear the timer.
        let at = at.map(|Instant(at_ns)| Duration::from_nanos(at_ns.max(1)));
        Ok(events::timer_set(&self.timer, at)?)
    }

    /// Makes the timer unreadable. Returns whether it was readable.
    pub fn drain(&self) -> bool {
        // Does not block, and repeats interrupted calls.
        match self.timer.wait() {
            Ok(()) => true,
            Err(errno) => {
                debug_assert_eq!(errno, Errno::EAGAIN);
                false
            }
        }
    }
}

impl AsFd for Timer {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.timer.as_fd()
    }
}
