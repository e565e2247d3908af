//! An interface and a control side that a wait set watches, together with descriptors of other things.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;

use sm2_io::{Maker, Waker};

use super::context::Context;
use super::interface::DeclaredInterface;
use super::shared_interface::{LockedInterface, SharedInterface};
use super::undriven_control::UndrivenControl;

/// An interface that a wait set watches: a sleeper that stays registered, like a [`Bell`](super::bell::Bell), without a
/// set of its own.
#[derive(Debug)]
pub(crate) struct Watch {
    interface: Arc<SharedInterface>,
    waker: Arc<Waker>,
    /// The process that created it.
    maker: Maker,
}

impl Watch {
    /// From now on, no event is missed: the caller watches [`descriptors`](Self::descriptors), and then looks.
    pub(crate) fn new(interface: &Arc<SharedInterface>) -> io::Result<Self> {
        let waker = interface.lock().sleepers.enter()?;
        Ok(Self {
            interface: Arc::clone(interface),
            waker,
            maker: Maker::this_process(),
        })
    }

    pub(crate) fn is_of(&self, interface: &Arc<SharedInterface>) -> bool {
        Arc::ptr_eq(&self.interface, interface)
    }

    /// Whether this control side is that of its node.
    pub(crate) fn is_driven_by(&self, control: &UndrivenControl) -> bool {
        control.is_of(&self.interface.sets.node)
    }

    /// Readable when the interface may have an event.
    pub(crate) fn descriptors(&self) -> [BorrowedFd<'_>; 2] {
        [self.interface.sets.calls.as_fd(), self.waker.as_fd()]
    }

    /// Reads the sockets, because a descriptor had an event, and looks as [`look`](Self::look) does.
    pub(crate) fn read_and_look(
        &self,
        look: impl FnMut(&mut DeclaredInterface, &mut Context<'_>) -> bool,
    ) -> bool {
        let mut locked = self.interface.lock();
        locked.sleepers.attend(&self.waker);
        locked.drive_at(sm2_io::clock::now());
        self.look_in(locked, look)
    }

    /// Looks for what the caller waits for. `look` returns whether it has found everything. If it has not, the
    /// interface prepares for the sleep of the caller, and `look` is called once more. Afterwards the descriptors
    /// become readable at the next event. Returns whether the kernel had no memory to use a socket: it is still
    /// ready, so the caller pauses before it waits.
    pub(crate) fn look(
        &self,
        look: impl FnMut(&mut DeclaredInterface, &mut Context<'_>) -> bool,
    ) -> bool {
        self.look_in(self.interface.lock(), look)
    }

    fn look_in(
        &self,
        mut locked: LockedInterface<'_>,
        mut look: impl FnMut(&mut DeclaredInterface, &mut Context<'_>) -> bool,
    ) -> bool {
        // Events until now are seen by the look below, under the same lock.
        locked.sleepers.clear(&self.waker);
        if locked.change(&mut look) {
            return locked.short_of_memory;
        }
        //= SM2-RNG-012
        locked.park();
        locked.change(&mut look);
        locked.short_of_memory
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        // In a child that was made by `fork(2)`, another thread of the parent may have held the lock.
        if !self.maker.is_parent() {
            self.interface.lock().sleepers.leave(&self.waker);
        }
    }
}
