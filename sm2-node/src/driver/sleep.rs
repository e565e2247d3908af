//! Sleeping until a descriptor has an event.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::thread;
use std::time::Duration;

use sm2_io::{Waker, is_shortage, wait_readable};

use super::limits::SHORTAGE_PAUSE;

/// Sleeps until one of `sets` has an event, another thread signals `waker`, or the timeout. If the kernel has no memory
/// for an event, pauses instead, but not after a signal.
//= SM2-TRN-014
pub(super) fn sleep(
    sets: &[BorrowedFd<'_>],
    waker: Option<&Waker>,
    short_of_memory: bool,
    timeout: Option<Duration>,
) -> io::Result<()> {
    let pause = timeout.map_or(SHORTAGE_PAUSE, |it| it.min(SHORTAGE_PAUSE));
    let waker = waker.map(AsFd::as_fd);
    let waited = match (short_of_memory, sets, waker) {
        (true, _, waker) => wait_readable(waker.as_slice(), Some(pause)),
        (false, &[set], Some(waker)) => wait_readable(&[set, waker], timeout),
        (false, &[set, control], Some(waker)) => wait_readable(&[set, control, waker], timeout),
        (false, sets, _) => wait_readable(sets, timeout),
    };
    match waited {
        Err(error) if is_shortage(&error) => {
            thread::sleep(pause);
            Ok(())
        }
        waited => waited.map(drop),
    }
}
