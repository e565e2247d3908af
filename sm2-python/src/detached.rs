//! Calls without the GIL, and their end before the interpreter ends.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use pyo3::prelude::*;

use crate::errors::ExitError;
use crate::logging;

/// How long the end of the interpreter waits for calls without the GIL: longer than a slice of a wait, and than the
/// default timeout of a publication.
const END_MAX: Duration = Duration::from_secs(5);

/// Set once the interpreter is about to end.
static ENDING: AtomicBool = AtomicBool::new(false);

/// The number of threads in a call without the GIL. Changed by threads that have the GIL.
static INSIDE: AtomicUsize = AtomicUsize::new(0);

/// Runs `call` without the GIL, and then passes queued log records on to `logging`.
///
/// CPython ends a thread that asks for the GIL of an interpreter that has ended. Such an end must not hit a thread below
/// a function of Rust, so no call begins once the interpreter is about to end: see [`end_calls`].
///
/// # Errors
///
/// [`ExitError`].
pub(crate) fn detached<T: Send>(py: Python<'_>, call: impl FnOnce() -> T + Send) -> PyResult<T> {
    if ENDING.load(Ordering::SeqCst) {
        return Err(ExitError::new_err(
            "the interpreter is about to end: end your threads before, or join them",
        ));
    }
    INSIDE.fetch_add(1, Ordering::SeqCst);
    let _leave = Leave;
    let result = py.detach(call);
    logging::forward(py);
    Ok(result)
}

/// Counts the call as over, also if it panics.
struct Leave;

impl Drop for Leave {
    fn drop(&mut self) {
        // After `forked`, the count is 0 although this thread is inside.
        let _ = INSIDE.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |it| it.checked_sub(1));
    }
}

/// Makes every wait end with an `ExitError`, and waits until no thread is in a call without the GIL.
///
/// Called by `atexit`.
#[pyfunction(name = "_end_calls")]
pub(crate) fn end_calls(py: Python<'_>) {
    ENDING.store(true, Ordering::SeqCst);
    logging::forward(py);
    let start = Instant::now();
    while INSIDE.load(Ordering::SeqCst) > 0 && start.elapsed() < END_MAX {
        py.detach(|| thread::sleep(Duration::from_millis(1)));
    }
}

/// Forgets the parent's threads in a forked child, which does not have them.
///
/// Called by `os.register_at_fork`.
#[pyfunction(name = "_forked")]
pub(crate) fn forked() {
    INSIDE.store(0, Ordering::SeqCst);
}
