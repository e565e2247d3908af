//! Waits that Ctrl-C ends.
//!
//! A signal ends `poll(2)` with `EINTR`; then the handlers that the program set in Python run. A signal that arrives
//! just before the call of `poll` does not end it, so no wait sleeps longer than [`SLICE`] at a time. Then a wait also
//! notices that another thread has closed its object.

use std::os::fd::{AsFd, BorrowedFd};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::{Duration, Instant};

use nix::errno::Errno;
use nix::poll::{PollFd, PollFlags, PollTimeout, poll};
use pyo3::prelude::*;

use crate::detached::detached;

/// The longest sleep between two looks at signals.
const SLICE: Duration = Duration::from_millis(250);

/// The end of a wait.
pub(crate) struct Deadline(Option<Instant>);

impl Deadline {
    /// The time `timeout` from now; without it, never. A time beyond the clock's range is never, too.
    pub(crate) fn new(timeout: Option<Duration>) -> Self {
        Self(timeout.and_then(|it| Instant::now().checked_add(it)))
    }

    /// The time until the end of the wait, at most a slice. `None` once the wait is over.
    fn slice(&self) -> Option<Duration> {
        let left = self.left();
        (!left.is_zero()).then_some(left.min(SLICE))
    }

    /// The time until the end of the wait.
    pub(crate) fn left(&self) -> Duration {
        self.0.map_or(Duration::MAX, |end| {
            end.saturating_duration_since(Instant::now())
        })
    }
}

/// Waits until `look` finds something; `None` after the timeout. `look` is called again each time the descriptor of
/// `handle` is readable, and once in each slice.
///
/// # Errors
///
/// Those of `look`, `KeyboardInterrupt` and other exceptions of signal handlers, `OSError`.
pub(crate) fn until_found<T>(
    py: Python<'_>,
    timeout: Option<Duration>,
    handle: &(impl AsFd + Sync),
    mut look: impl FnMut() -> PyResult<Option<T>>,
) -> PyResult<Option<T>> {
    if let Some(found) = look()? {
        return Ok(Some(found));
    }
    let deadline = Deadline::new(timeout);
    // After a shortage of descriptors it is another one, so each slice asks for it.
    while let Some(slice) = deadline.slice() {
        detached(py, || sleep(handle.as_fd(), slice))?;
        py.check_signals()?;
        if let Some(found) = look()? {
            return Ok(Some(found));
        }
    }
    Ok(None)
}

/// Sleeps until the descriptor is readable, a signal arrives, or the time is over.
fn sleep(descriptor: BorrowedFd<'_>, time: Duration) -> PyResult<()> {
    // Rounded up, so that the end of a wait is not polled for.
    let ms = time.as_nanos().div_ceil(1_000_000);
    let timeout = PollTimeout::from(u16::try_from(ms).unwrap_or(u16::MAX));
    match poll(&mut [PollFd::new(descriptor, PollFlags::POLLIN)], timeout) {
        Ok(_) | Err(Errno::EINTR) => Ok(()),
        Err(error) => Err(std::io::Error::from(error).into()),
    }
}

/// Calls `wait` with the time of one slice after the other, until it returns something or the timeout is over. `wait`
/// is called at least once.
///
/// # Errors
///
/// Those of `wait`, and exceptions of signal handlers.
pub(crate) fn in_slices<T: Send>(
    py: Python<'_>,
    timeout: Option<Duration>,
    mut wait: impl FnMut(Duration) -> PyResult<Option<T>> + Send,
) -> PyResult<Option<T>> {
    let deadline = Deadline::new(timeout);
    let mut slice = deadline.slice();
    loop {
        let found = detached(py, || wait(slice.unwrap_or(Duration::ZERO)))?;
        py.check_signals()?;
        slice = deadline.slice();
        if found.is_some() || slice.is_none() {
            return Ok(found);
        }
    }
}

/// Runs `call` on a thread of its own, so that a signal can end the wait for its result: for calls that wait for the
/// Manager. If a signal does, the thread drops the result when it has one.
///
/// # Errors
///
/// Exceptions of signal handlers, and `OSError` if there can be no further thread.
pub(crate) fn on_thread<T: Send + 'static>(
    py: Python<'_>,
    call: impl FnOnce() -> T + Send + 'static,
) -> PyResult<T> {
    let (sender, receiver) = channel();
    let thread = thread::Builder::new().name("sm2-call".into());
    thread.spawn(move || sender.send(call()))?;
    // A channel can be shared by reference only while this thread alone uses it.
    let receiver = std::sync::Mutex::new(receiver);
    loop {
        let received = detached(py, || {
            let receiver = receiver.lock().unwrap_or_else(|it| it.into_inner());
            receiver.recv_timeout(SLICE)
        });
        // Also with a result: a caller may begin the next wait at once.
        py.check_signals()?;
        match received {
            Ok(result) => return Ok(result),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => {
                return Err(crate::errors::Error::new_err(
                    "a call of SM2 ended without a result; standard error says why",
                ));
            }
        }
    }
}
