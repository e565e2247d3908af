//! Futexes in shared memory.

use std::{sync::atomic::AtomicU32, time::Duration};

use nix::{libc, sys::time::TimeSpec};

/// Sleeps until [`wake_all`], at most for `timeout`, if the word is `expected`. May return early.
pub(super) fn wait(word: &AtomicU32, expected: u32, timeout: Duration) {
    let timeout = TimeSpec::from_duration(timeout);
    // SAFETY: the word and the timeout outlive the call; the kernel reads both and writes neither.
    // The result is not needed: the caller checks its condition again in every case.
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

/// Wakes all threads that sleep at the word.
pub(super) fn wake_all(word: &AtomicU32) {
    // SAFETY: the kernel does not access the memory; the address only identifies the futex.
    unsafe {
        libc::syscall(libc::SYS_futex, word.as_ptr(), libc::FUTEX_WAKE, i32::MAX);
    }
}
