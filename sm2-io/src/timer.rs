//! Waking an event loop at a moment.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use nix::errno::Errno;
use nix::sys::time::TimeSpec;
use nix::sys::timerfd::{ClockId, Expiration, TimerFd, TimerFlags, TimerSetTimeFlags};
use sm2_proto::Instant;

/// A `timerfd` on the clock of [`now`](crate::clock::now): readable from the moment it is
/// [set](Self::set) to, until [`drain`](Self::drain) or the next `set`.
///
/// For those who put one descriptor into an event loop of their own, and cannot give that
/// loop a deadline. Close-on-exec, non-blocking.
#[derive(Debug)]
pub struct Timer {
    timer: TimerFd,
}

impl Timer {
    /// A timer that is not set.
    ///
    /// # Errors
    ///
    /// Whatever `timerfd_create(2)` says: too many descriptors, no memory.
    pub fn new() -> io::Result<Self> {
        let flags = TimerFlags::TFD_NONBLOCK | TimerFlags::TFD_CLOEXEC;
        let timer = TimerFd::new(ClockId::CLOCK_MONOTONIC, flags)?;
        Ok(Self { timer })
    }

    /// Sets the moment, in place of any before; `None`: never. A moment that has passed makes
    /// it readable at once.
    ///
    /// # Errors
    ///
    /// None are expected of a timer that exists.
    pub fn set(&self, at: Option<Instant>) -> io::Result<()> {
        let Some(Instant(at_ns)) = at else {
            return Ok(self.timer.unset()?);
        };
        // To the kernel, zero means never.
        let at = TimeSpec::from_duration(Duration::from_nanos(at_ns.max(1)));
        let flags = TimerSetTimeFlags::TFD_TIMER_ABSTIME;
        Ok(self.timer.set(Expiration::OneShot(at), flags)?)
    }

    /// Makes the timer unreadable; whether it was readable.
    pub fn drain(&self) -> bool {
        // Never waits. Interrupted calls are repeated inside.
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
