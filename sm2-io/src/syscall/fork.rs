//! Children made by `fork(2)`: how they know that they are, and which descriptors they do not keep.
//!
//! Such a child has copies of all descriptors of its parent, and a socket or a lock ends with its last copy. A child
//! that outlives its parent would therefore keep what the parent served. In the child, each of these numbers refers to
//! an unused eventfd instead: they are not closed, because the child also has copies of the values that own them.
//!
//! `posix_spawn(3)` and `exec(3)` close all descriptors of SM2. A child that was made by `clone(2)` directly keeps its
//! copies, and so does one that was made while the descriptor was being created, or that has no descriptor left.

use std::os::fd::{AsRawFd, BorrowedFd, RawFd};
use std::sync::Once;

use nix::libc;

use crate::sync::{AtomicU64, Ordering::Relaxed};

/// The numbers below this are noted. A process with more descriptors has raised its limit far above the usual one.
const NUMBERS: usize = 1 << 16;
const BITS: usize = u64::BITS as usize;

/// One bit for each number. Relaxed, because a child is made with a copy of the memory as the forking thread sees it.
static NOTED: [AtomicU64; NUMBERS / BITS] = [const { AtomicU64::new(0) }; NUMBERS / BITS];

/// How many forks are between this process and the one that has loaded this library.
static FORKS: AtomicU64 = AtomicU64::new(0);

/// How many forks are between this process and the one that has loaded this library. Unlike `getpid(2)`, this needs no
/// system call. A child that was made by `clone(2)` directly has the number of its parent.
pub(crate) fn forks() -> u64 {
    handle_forks();
    FORKS.load(Relaxed)
}

fn handle_forks() {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        // SAFETY: the handler is a function of this library, and makes only calls that are safe after `fork`. If there
        // is no memory for the handler, a child takes itself for its parent, and keeps the descriptors.
        let _ = unsafe { libc::pthread_atfork(None, None, Some(in_child)) };
    });
}

/// A note that the children of this process do not keep a descriptor. It is dropped before the descriptor is closed.
#[derive(Debug)]
pub(crate) struct Unforked {
    number: RawFd,
}

impl Unforked {
    /// Notes an open descriptor.
    pub(crate) fn new(fd: BorrowedFd<'_>) -> Self {
        handle_forks();
        let number = fd.as_raw_fd();
        if let Some((word, bit)) = place(number) {
            word.fetch_or(bit, Relaxed);
        }
        Self { number }
    }
}

impl Drop for Unforked {
    fn drop(&mut self) {
        if let Some((word, bit)) = place(self.number) {
            word.fetch_and(!bit, Relaxed);
        }
    }
}

fn place(number: RawFd) -> Option<(&'static AtomicU64, u64)> {
    let number = usize::try_from(number).ok()?;
    Some((NOTED.get(number / BITS)?, 1 << (number % BITS)))
}

/// Counts the fork, and gives up the copies of the noted descriptors. Runs in the child, before `fork` returns, so it
/// may neither allocate nor lock.
extern "C" fn in_child() {
    FORKS.fetch_add(1, Relaxed);
    let mut unused = None;
    for (index, word) in NOTED.iter().enumerate() {
        let mut bits = word.load(Relaxed);
        while bits != 0 {
            let number = index * BITS + bits.trailing_zeros() as usize;
            bits &= bits - 1;
            // SAFETY: the call takes two integers.
            let unused =
                *unused.get_or_insert_with(|| unsafe { libc::eventfd(0, libc::EFD_CLOEXEC) });
            let Ok(number) = RawFd::try_from(number) else {
                continue;
            };
            // SAFETY: the owner of `number` stays its owner, and finds a descriptor without effects there. Without one
            // to duplicate, the call does nothing.
            unsafe { libc::dup3(unused, number, libc::O_CLOEXEC) };
        }
    }
    if let Some(unused) = unused {
        // SAFETY: this function has opened it, or it is -1; nothing else knows it.
        unsafe { libc::close(unused) };
    }
}

#[cfg(test)]
mod tests;
