//! A signal to any number of threads that stays set.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};

use nix::errno::Errno;

use crate::Waker;
use crate::sync::{AtomicU64, Ordering};

/// A signal that is set once and for all. Its descriptor is readable as soon as it is set, and
/// [`is_set`](Self::is_set) tells without a system call.
#[derive(Debug)]
pub struct Latch {
    set: AtomicU64,
    /// Never drained.
    waker: Waker,
}

impl Latch {
    /// Makes a latch that is not set.
    ///
    /// # Errors
    ///
    /// Any error of `eventfd(2)`, such as too many descriptors or no memory.
    pub fn new() -> io::Result<Self> {
        Ok(Self {
            set: AtomicU64::new(0),
            waker: Waker::new()?,
        })
    }

    /// Sets the latch. Never blocks, and is async-signal-safe: it stores a word, writes to an
    /// eventfd, and leaves `errno` as it was.
    pub fn set(&self) {
        // The store comes before the write, so a thread that the descriptor wakes finds the word set.
        // Pairs with the load in `is_set`.
        self.set.store(1, Ordering::Release);
        let errno = Errno::last_raw();
        self.waker.wake();
        Errno::set_raw(errno);
    }

    /// Whether the latch is set.
    #[must_use]
    #[inline]
    pub fn is_set(&self) -> bool {
        // Pairs with the store in `set`.
        self.set.load(Ordering::Acquire) != 0
    }
}

impl AsFd for Latch {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.waker.as_fd()
    }
}
