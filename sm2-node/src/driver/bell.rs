//! A descriptor that a program polls in its own loop: a sleeper that stays registered.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;

use sm2_io::{Epoll, Interest, Waker};
use sm2_proto::InterfaceId;

use super::sleepers::EventSource;
use super::{Inner, SharedNode};

/// A descriptor that becomes readable when an interface may have an event: an epoll set that
/// contains the node's set for calls and a waker.
#[derive(Debug)]
pub(crate) struct Bell {
    set: Epoll,
    waker: Arc<Waker>,
}

impl Bell {
    /// Creates a bell that is already signalled, because there may already be something to take.
    pub(crate) fn new(shared: &SharedNode, interface: InterfaceId) -> io::Result<Self> {
        let set = Epoll::new()?;
        set.add(&shared.sets, 0, Interest::READABLE)?;
        let mut inner = shared.lock();
        let source = EventSource::Interface(interface);
        let waker = inner.sleepers.enter(source)?;
        let bell = Self { set, waker };
        if let Err(error) = bell.set.add(&*bell.waker, 1, Interest::READABLE) {
            inner.sleepers.leave(&bell.waker);
            return Err(error);
        }
        inner.sleepers.wake(source);
        Ok(bell)
    }

    /// Resets the bell, so that it becomes readable at the next event. Returns whether it was
    /// signalled.
    pub(crate) fn silence(&self, inner: &mut Inner) -> bool {
        inner.sleepers.calm(&self.waker)
    }

    /// Removes the bell, because the program does not poll it any more.
    pub(crate) fn remove(&self, inner: &mut Inner) {
        inner.sleepers.leave(&self.waker);
    }
}

impl AsFd for Bell {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.set.as_fd()
    }
}
