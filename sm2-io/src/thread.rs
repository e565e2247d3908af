//! Threads of a library in the processes of others.

use std::io;
use std::thread::{Builder, JoinHandle};

use crate::syscall::signals;

/// Starts a thread in which all signals are blocked, so that the handlers of the program run on the program's own
/// threads. The kernel keeps the first 15 bytes of `name`.
///
/// The thread inherits the scheduling policy, the priority and the affinity of the calling thread.
///
/// # Errors
///
/// Any error of `pthread_create(3)`, such as too many threads or no memory.
pub fn spawn_without_signals<T: Send + 'static>(
    name: String,
    body: impl FnOnce() -> T + Send + 'static,
) -> io::Result<JoinHandle<T>> {
    #[cfg(feature = "fault-injection")]
    let body = crate::fault::inherited(body);
    // A new thread inherits the mask, so no signal reaches it before its first instruction.
    let mask = signals::block_all();
    let thread = Builder::new().name(name).spawn(body);
    signals::set_mask(&mask);
    thread
}
