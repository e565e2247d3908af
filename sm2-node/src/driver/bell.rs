//! A descriptor that a program polls in its own loop: a sleeper that stays registered.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;

use sm2_io::{Epoll, Interest, Waker};

use super::shared_interface::{InterfaceDriver, SharedInterface};

/// A descriptor that becomes readable when an interface may have an event: an epoll set that
/// contains the interface's set and a waker, and the control set if calls drive the node.
#[derive(Debug)]
pub(crate) struct Bell {
    set: Epoll,
    waker: Arc<Waker>,
}

impl Bell {
    /// Creates a bell that is already signalled, because there may already be something to take.
    pub(crate) fn new(interface: &SharedInterface) -> io::Result<Self> {
        let set = Epoll::new()?;
        set.add(&interface.sets.calls, 0, Interest::READABLE)?;
        if !interface.sets.has_background() {
            set.add(interface.sets.control(), 0, Interest::READABLE)?;
        }
        let mut locked = interface.lock();
        let waker = locked.sleepers.enter()?;
        let bell = Self { set, waker };
        if let Err(error) = bell.set.add(&*bell.waker, 1, Interest::READABLE) {
            locked.sleepers.leave(&bell.waker);
            return Err(error);
        }
        locked.sleepers.wake();
        Ok(bell)
    }

    /// Resets the bell, so that it becomes readable at the next event. Returns whether it was
    /// signalled.
    pub(crate) fn clear(&self, interface: &mut InterfaceDriver) -> bool {
        interface.sleepers.clear(&self.waker)
    }

    /// Removes the bell, because the program does not poll it any more.
    pub(crate) fn remove(&self, interface: &SharedInterface) {
        interface.lock().sleepers.leave(&self.waker);
    }
}

impl AsFd for Bell {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.set.as_fd()
    }
}
