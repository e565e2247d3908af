//! Sleeping until a descriptor has an event.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::thread;
use std::time::Duration;

use sm2_io::{Waker, is_shortage, wait_readable};

use super::limits::SHORTAGE_PAUSE;

/// The most descriptors of one sleep: two sets, a waker, and a shutdown.
const DESCRIPTORS: usize = 4;

/// Sleeps until one of `sets` has an event, another thread signals `waker`, the program requests a shutdown, or the
/// timeout. If the kernel has no memory for an event, pauses instead, but not after a signal.
//= SM2-TRN-013
pub(super) fn sleep(
    sets: &[BorrowedFd<'_>],
    waker: Option<&Waker>,
    shutdown: Option<BorrowedFd<'_>>,
    short_of_memory: bool,
    timeout: Option<Duration>,
) -> io::Result<()> {
    let pause = timeout.map_or(SHORTAGE_PAUSE, |it| it.min(SHORTAGE_PAUSE));
    let timeout = if short_of_memory {
        Some(pause)
    } else {
        timeout
    };
    let sets = if short_of_memory { &[] } else { sets };
    let signals = [waker.map(AsFd::as_fd), shutdown];
    let mut all = sets.iter().copied().chain(signals.into_iter().flatten());
    let waited = match all.next() {
        None => wait_readable(&[], timeout),
        Some(first) => {
            let mut fds = [first; DESCRIPTORS];
            let mut count = 1;
            for (place, fd) in fds[1..].iter_mut().zip(all) {
                *place = fd;
                count += 1;
            }
            wait_readable(&fds[..count], timeout)
        }
    };
    match waited {
        Err(error) if is_shortage(&error) => {
            thread::sleep(pause);
            Ok(())
        }
        waited => waited.map(drop),
    }
}
