//! Messages to the thread of an executor that waits.

use std::fmt;
use std::io;
use std::mem;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::{Mutex, MutexGuard, PoisonError};

use sm2_io::Waker;

use super::id::CallbackId;
use super::turn::Due;

/// Messages to the thread of an executor that waits for its sources. Its descriptor wakes that thread.
pub(super) struct Mailbox<A> {
    letters: Mutex<Letters<A>>,
    waker: Waker,
}

/// The wishes of callbacks and of other threads. `A` adds a source and its callback.
pub(super) struct Letters<A> {
    pub(super) additions: Vec<A>,
    pub(super) removals: Vec<CallbackId>,
    /// Callbacks that have waited for the turn of their group, which is free now.
    pub(super) resumed: Vec<Due>,
    /// Whether all threads have to end.
    pub(super) is_over: bool,
    /// The number of the last callback.
    last_id: u64,
}

impl<A> Default for Letters<A> {
    fn default() -> Self {
        Self {
            additions: Vec::new(),
            removals: Vec::new(),
            resumed: Vec::new(),
            is_over: false,
            last_id: 0,
        }
    }
}

impl<A> Mailbox<A> {
    pub(super) fn new() -> io::Result<Self> {
        Ok(Self {
            letters: Mutex::default(),
            waker: Waker::new()?,
        })
    }

    /// Allocates a number for a callback.
    pub(super) fn next_id(&self) -> CallbackId {
        let mut letters = self.letters();
        letters.last_id += 1;
        CallbackId(letters.last_id)
    }

    /// Leaves letters, and wakes the thread that waits.
    pub(super) fn leave(&self, write: impl FnOnce(&mut Letters<A>)) {
        write(&mut self.letters());
        // After the letters are there: the thread that waits drains the waker before it takes them.
        self.waker.wake();
    }

    /// Takes all letters. Called by the thread that waits, when the descriptor is readable.
    pub(super) fn take(&self) -> Letters<A> {
        self.waker.drain();
        let mut letters = self.letters();
        Letters {
            additions: mem::take(&mut letters.additions),
            removals: mem::take(&mut letters.removals),
            resumed: mem::take(&mut letters.resumed),
            ..Letters::default()
        }
    }

    /// Whether a letter asks for the removal of a callback.
    pub(super) fn has_removals(&self) -> bool {
        !self.letters().removals.is_empty()
    }

    /// The threads are about to start.
    pub(super) fn begin(&self) {
        self.letters().is_over = false;
    }

    /// Whether all threads have to end.
    pub(super) fn is_over(&self) -> bool {
        self.letters().is_over
    }

    /// Drops all letters, because no thread will read them.
    pub(super) fn close(&self) {
        // Dropped without the lock: an addition may own a group, and with it this mailbox.
        let letters = self.take();
        drop(letters);
    }

    /// No code that can panic runs under the lock.
    fn letters(&self) -> MutexGuard<'_, Letters<A>> {
        self.letters.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Readable when there are letters.
impl<A> AsFd for Mailbox<A> {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.waker.as_fd()
    }
}

impl<A> fmt::Debug for Mailbox<A> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Mailbox").finish_non_exhaustive()
    }
}
