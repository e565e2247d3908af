//! The threads that wait at a node, and how one thread wakes another for which it received
//! something.
//!
//! Each thread that calls the node may read all of its links, and the background thread reads some of
//! them. While one thread sleeps until its message comes, another thread may read that message from
//! the socket. A sleeping thread therefore waits for two descriptors: the node's set for calls
//! (level-triggered), and a waker of its own. A thread that drives the node signals the waker when
//! an event concerns the source that the sleeper has named. A sleeper registers its source under the
//! node's lock, after it has looked and found nothing, so it misses no event.

use std::io;
use std::sync::Arc;

use sm2_io::Waker;
use sm2_proto::InterfaceId;

/// The events for which a sleeper waits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum EventSource {
    /// All events of this interface and its links, and the end of the session.
    Interface(InterfaceId),
    /// The session with the Manager.
    Session,
}

/// The number of unused wakers that a node keeps, so that a thread that waits again and again makes no
/// descriptor for it.
const SPARES: usize = 4;

/// All registered sleepers.
#[derive(Debug)]
pub(super) struct Sleepers {
    all: Vec<Sleeper>,
    /// Wakers that no sleeper uses now, at most [`SPARES`].
    spare: Vec<Arc<Waker>>,
}

#[derive(Debug)]
struct Sleeper {
    source: EventSource,
    waker: Arc<Waker>,
    woken: bool,
}

impl Sleepers {
    /// Creates an empty list, and a waker for the first sleeper.
    pub(super) fn new() -> io::Result<Self> {
        Ok(Self {
            all: Vec::new(),
            spare: vec![Arc::new(Waker::new()?)],
        })
    }

    /// Wakes the sleepers of this source. [`EventSource::Session`] wakes all.
    pub(super) fn wake(&mut self, source: EventSource) {
        for sleeper in &mut self.all {
            if !sleeper.woken && (sleeper.source == source || source == EventSource::Session) {
                sleeper.woken = true;
                sleeper.waker.wake();
            }
        }
    }

    pub(super) fn enter(&mut self, source: EventSource) -> io::Result<Arc<Waker>> {
        let waker = match self.spare.pop() {
            Some(waker) => waker,
            None => Arc::new(Waker::new()?),
        };
        self.all.push(Sleeper {
            source,
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

#[cfg(test)]
mod tests {
    use super::{EventSource, SPARES, Sleepers};

    #[test]
    fn a_burst_of_sleepers_leaves_few_descriptors() {
        let mut sleepers = Sleepers::new().unwrap();
        let enter = |_| sleepers.enter(EventSource::Session).unwrap();
        let wakers: Vec<_> = (0..SPARES + 3).map(enter).collect();
        wakers.iter().for_each(|it| sleepers.leave(it));
        assert_eq!((sleepers.all.len(), sleepers.spare.len()), (0, SPARES));
    }
}
