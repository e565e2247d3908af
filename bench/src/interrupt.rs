//! Ctrl-C, which ends a run in order: first its processes, then the director.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    thread,
};

use nix::sys::signal::{SigSet, Signal};

static CAME: AtomicBool = AtomicBool::new(false);

/// Watches for SIGINT and SIGTERM; a second signal ends the process at once. Call this before the
/// first thread starts.
///
/// # Errors
///
/// The signals cannot be blocked, or the thread cannot be started.
pub fn watch() -> std::io::Result<()> {
    let mut signals = SigSet::empty();
    signals.add(Signal::SIGINT);
    signals.add(Signal::SIGTERM);
    signals.thread_block()?;
    thread::Builder::new().spawn(move || {
        while signals.wait().is_ok() {
            if CAME.swap(true, Ordering::Relaxed) {
                std::process::exit(130);
            }
        }
    })?;
    Ok(())
}

/// True if SIGINT or SIGTERM has arrived.
#[must_use]
pub fn came() -> bool {
    CAME.load(Ordering::Relaxed)
}
