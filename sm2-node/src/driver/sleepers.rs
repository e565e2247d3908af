//! The threads that wait for one interface, or for the session, and how one thread wakes another for which it did
//! something.
//!
//! While one thread sleeps until its message comes, another thread may read that message from the socket, or the
//! background thread may change the state for which the first one waits. A sleeping thread therefore waits for two
//! descriptors: an epoll set (level-triggered), and a waker of its own. A thread that changes the interface or the
//! session signals the wakers of its sleepers. A sleeper registers under the lock, after it has looked and found
//! nothing, so it misses no event.

use std::io;
use std::sync::Arc;

use sm2_io::Waker;

/// The number of unused wakers that an interface keeps, so that a thread that waits again and again makes no
/// descriptor for it.
pub(super) const SPARES: usize = 2;

/// The threads that wait for one interface, or for the session.
#[derive(Debug, Default)]
pub(super) struct Sleepers {
    all: Vec<Sleeper>,
    /// Wakers that no sleeper uses now, at most [`SPARES`].
    spare: Vec<Arc<Waker>>,
}

#[derive(Debug)]
struct Sleeper {
    waker: Arc<Waker>,
    woken: bool,
}

impl Sleepers {
    /// Wakes all sleepers.
    pub(super) fn wake(&mut self) {
        for sleeper in &mut self.all {
            if !sleeper.woken {
                sleeper.woken = true;
                sleeper.waker.wake();
            }
        }
    }

    pub(super) fn enter(&mut self) -> io::Result<Arc<Waker>> {
        let waker = match self.spare.pop() {
            Some(waker) => waker,
            None => Arc::new(Waker::new()?),
        };
        self.all.push(Sleeper {
            waker: Arc::clone(&waker),
            woken: false,
        });
        Ok(waker)
    }

    pub(super) fn leave(&mut self, waker: &Arc<Waker>) {
        self.calm(waker);
        self.all.retain(|it| !Arc::ptr_eq(&it.waker, waker));
        if self.spare.len() < SPARES {
            self.spare.push(Arc::clone(waker));
        }
    }

    /// How many threads sleep, and how many wakers are spare.
    #[cfg(test)]
    pub(super) fn counts(&self) -> (usize, usize) {
        (self.all.len(), self.spare.len())
    }

    /// Notes that the sleeper has seen all events until now. Returns whether it was woken for one.
    pub(super) fn calm(&mut self, waker: &Arc<Waker>) -> bool {
        let sleeper = self.all.iter_mut().find(|it| Arc::ptr_eq(&it.waker, waker));
        let Some(sleeper) = sleeper.filter(|it| it.woken) else {
            return false;
        };
        sleeper.woken = false;
        sleeper.waker.drain();
        true
    }
}
