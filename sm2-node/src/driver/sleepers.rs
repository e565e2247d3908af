//! The threads that wait for one interface, or for the session, and how one thread wakes another when it did
//! something for it.
//!
//! While one thread sleeps until its message comes, another thread may read that message from the socket, or the
//! background thread may change the state that the first one waits for. A sleeping thread therefore waits for two
//! descriptors: an epoll set (level-triggered), and a waker of its own. A thread that changes the interface or the
//! session signals the wakers of its sleepers. A sleeper registers under the lock, after it has looked and found
//! nothing, so it misses no event.

use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use sm2_io::Waker;

/// The number of unused wakers that a node keeps, so that a thread that waits again and again makes no
/// descriptor for it.
pub(super) const SPARES: usize = 4;

/// The wakers of a node that no sleeper uses now, at most [`SPARES`]. Its lock is the last one in the order of locks.
#[derive(Debug)]
pub(super) struct SpareWakers(Mutex<Vec<Arc<Waker>>>);

impl SpareWakers {
    /// Makes the wakers for the node's descriptor and for the first sleeper.
    pub(super) fn new() -> io::Result<Self> {
        let (descriptor, sleeper) = (Waker::new()?, Waker::new()?);
        Ok(Self(Mutex::new(vec![
            Arc::new(descriptor),
            Arc::new(sleeper),
        ])))
    }

    fn take(&self) -> io::Result<Arc<Waker>> {
        let spare = self.lock().pop();
        match spare {
            Some(waker) => Ok(waker),
            None => Waker::new().map(Arc::new),
        }
    }

    fn keep(&self, waker: &Arc<Waker>) {
        let mut spare = self.lock();
        if spare.len() < SPARES {
            spare.push(Arc::clone(waker));
        }
    }

    /// No code that can panic runs under the lock.
    fn lock(&self) -> MutexGuard<'_, Vec<Arc<Waker>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How many wakers are kept.
    #[cfg(test)]
    pub(super) fn count(&self) -> usize {
        self.lock().len()
    }
}

/// The threads that wait for one interface, or for the session.
#[derive(Debug)]
pub(super) struct Sleepers {
    all: Vec<Sleeper>,
    spare: Arc<SpareWakers>,
}

#[derive(Debug)]
struct Sleeper {
    waker: Arc<Waker>,
    state: State,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Asleep,
    /// It holds the lock and will look before it sleeps again: it needs no signal.
    Attentive,
    /// Its waker was signalled.
    Woken,
}

impl Sleepers {
    pub(super) fn new(spare: &Arc<SpareWakers>) -> Self {
        Self {
            all: Vec::new(),
            spare: Arc::clone(spare),
        }
    }

    /// Wakes all sleepers.
    pub(super) fn wake(&mut self) {
        for sleeper in &mut self.all {
            if sleeper.state == State::Asleep {
                sleeper.state = State::Woken;
                sleeper.waker.wake();
            }
        }
    }

    pub(super) fn enter(&mut self) -> io::Result<Arc<Waker>> {
        let waker = self.spare.take()?;
        self.all.push(Sleeper {
            waker: Arc::clone(&waker),
            state: State::Asleep,
        });
        Ok(waker)
    }

    pub(super) fn leave(&mut self, waker: &Arc<Waker>) {
        self.clear(waker);
        self.all.retain(|it| !Arc::ptr_eq(&it.waker, waker));
        self.spare.keep(waker);
    }

    /// How many threads sleep.
    #[cfg(test)]
    pub(super) fn count(&self) -> usize {
        self.all.len()
    }

    /// Notes that the sleeper has the lock, and calls [`clear`](Self::clear) before it releases it. An event that its
    /// own call finds costs no signal then.
    pub(super) fn attend(&mut self, waker: &Arc<Waker>) {
        if let Some(sleeper) = self.find(waker)
            && sleeper.state == State::Asleep
        {
            sleeper.state = State::Attentive;
        }
    }

    /// Notes that the sleeper has seen all events until now. Returns whether it was woken for one.
    pub(super) fn clear(&mut self, waker: &Arc<Waker>) -> bool {
        let Some(sleeper) = self.find(waker) else {
            return false;
        };
        let was_woken = sleeper.state == State::Woken;
        sleeper.state = State::Asleep;
        if was_woken {
            sleeper.waker.drain();
        }
        was_woken
    }

    fn find(&mut self, waker: &Arc<Waker>) -> Option<&mut Sleeper> {
        self.all.iter_mut().find(|it| Arc::ptr_eq(&it.waker, waker))
    }
}
