//! Control-C ends a run in good order: its processes first.

use std::{
    sync::atomic::{AtomicBool, Ordering},
    thread,
};

use nix::sys::signal::{SigSet, Signal};

static CAME: AtomicBool = AtomicBool::new(false);

/// Watches for SIGINT and SIGTERM. To be called before any other thread is made. A second one
/// ends the process at once.
///
/// # Errors
///
/// The signals cannot be blocked, or there can be no thread.
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

/// Whether one came.
#[must_use]
pub fn came() -> bool {
    CAME.load(Ordering::Relaxed)
}
