//! Sleeping at a word of shared memory.

use std::{sync::atomic::AtomicU32, time::Duration};

use nix::{libc, sys::time::TimeSpec};

/// Sleeps until somebody wakes, as long as the word is still `expected`; not longer than this.
/// May return early.
pub(super) fn wait(word: &AtomicU32, expected: u32, timeout: Duration) {
    let timeout = TimeSpec::from_duration(timeout);
    // SAFETY: the word lives as long as its borrow, and the timeout until the call returns; the
    // kernel reads both and writes neither. Whatever it returns means: look again.
    unsafe {
        libc::syscall(
            libc::SYS_futex,
            word.as_ptr(),
            libc::FUTEX_WAIT,
            expected,
            std::ptr::from_ref(timeout.as_ref()),
        );
    }
}

/// Wakes all who sleep there.
pub(super) fn wake_all(word: &AtomicU32) {
    // SAFETY: the kernel uses the address as a name only.
    unsafe {
        libc::syscall(libc::SYS_futex, word.as_ptr(), libc::FUTEX_WAKE, i32::MAX);
    }
}
