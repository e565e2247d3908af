//! Processes that a signal has stopped.

use std::fs;

use crate::until;

/// Waits until SIGSTOP, which was sent to this process, has stopped all of its threads: the call that sends the signal
/// returns before.
///
/// # Panics
///
/// See [`until`].
#[track_caller]
pub fn wait_until_stopped(pid: u32) {
    until("all threads of a process are stopped", || are_stopped(pid));
}

fn are_stopped(pid: u32) -> bool {
    let Ok(threads) = fs::read_dir(format!("/proc/{pid}/task")) else {
        return false;
    };
    let mut states = threads.flatten().map(|thread| {
        let stat = fs::read_to_string(thread.path().join("stat")).unwrap_or_default();
        // The name in brackets before the state may contain any character.
        stat.rsplit_once(") ").and_then(|it| it.1.chars().next())
    });
    states.all(|it| it == Some('T'))
}
