//! The part that all four kinds of interface share.

pub(crate) mod declaration;
mod declare;
mod many;
pub(crate) mod methods;
pub(crate) mod receive;
mod store;

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

use sm2_proto::{Instant, Name};

use crate::driver::{
    Bell, Context, DeclaredInterface, Drive, InterfaceDriver, LinkStatus, LockedInterface,
    Reserved, SharedInterface, SharedNode,
};
use crate::{Wait, WaitError};

/// A declared interface. Dropping it withdraws the interface.
#[derive(Debug)]
pub(crate) struct Handle {
    pub(crate) interface: Arc<SharedInterface>,
    /// Keeps the node alive.
    pub(crate) shared: Arc<SharedNode>,
    pub(crate) name: Name,
    matched: usize,
    /// Payloads of up to this length are sent inside the datagram.
    pub(crate) inline_max: usize,
    /// How a thread waits for a message of this interface.
    pub(crate) wait: Wait,
    /// Created when a descriptor is requested for the first time. After a shortage, the next request tries again.
    bell: OnceLock<Bell>,
    /// Set when the program has requested a descriptor.
    polled: OnceLock<()>,
    /// Tasks that wait for the descriptor. They are notified when another task clears it: the runtime
    /// reports only changes, so they would miss that one.
    #[cfg(feature = "tokio")]
    pub(crate) cleared: Arc<tokio::sync::Notify>,
}

impl Handle {
    /// Sets how long unused memory is kept, and adopts reserved memory.
    pub(crate) fn keep(&self, idle: Duration, reserved: Option<Reserved>) {
        self.with_undriven(|interface, _| {
            interface.outbox.keep_idle(idle);
            if let Some(reserved) = reserved {
                interface.outbox.adopt(reserved);
            }
        });
    }

    /// Whether the current Manager has granted the interface.
    pub(crate) fn is_registered(&self) -> bool {
        self.shared.lock_driven().is_registered(self.interface.id)
    }

    pub(crate) const fn matched(&self) -> usize {
        self.matched
    }

    /// Drives the node and changes the interface.
    pub(crate) fn with_driven<R>(
        &self,
        change: impl FnOnce(&mut DeclaredInterface, &mut Context<'_>) -> R,
    ) -> R {
        self.with(Drive::Yes, change)
    }

    /// Changes the interface for a call that begins now, and reads sockets first as `drive` says.
    pub(crate) fn with<R>(
        &self,
        drive: Drive,
        change: impl FnOnce(&mut DeclaredInterface, &mut Context<'_>) -> R,
    ) -> R {
        self.interface.enter(drive).change(change)
    }

    /// Changes the interface, without driving the node, for a change that does not need the time.
    pub(crate) fn with_undriven<R>(
        &self,
        change: impl FnOnce(&mut DeclaredInterface, &mut Context<'_>) -> R,
    ) -> R {
        self.interface.lock().change(change)
    }

    pub(crate) fn links(&self) -> Vec<LinkStatus> {
        self.with_driven(|interface, _| interface.links.statuses())
    }

    /// Waits until `wanted` links are open.
    pub(crate) fn wait_open(
        &self,
        wanted: usize,
        timeout: Option<Duration>,
    ) -> Result<(), WaitError> {
        let mut found = 0;
        let waited = self.interface.wait(until(timeout), |interface, _| {
            found = interface.links.count_open();
            (found >= wanted).then_some(())
        });
        if waited?.is_some() {
            return Ok(());
        }
        let kind = self.with_undriven(|interface, _| interface.contract.kind().counterpart());
        let away = self.shared.lock().away();
        Err(match away {
            Some(end) => WaitError::ManagerGone {
                kind,
                found,
                wanted,
                end,
            },
            None => WaitError::TimedOut {
                kind,
                found,
                wanted,
            },
        })
    }

    /// Returns what `find` finds. If it finds nothing, clears the descriptor (if there is one) and looks
    /// once more, because a message may have arrived meanwhile.
    #[inline]
    pub(crate) fn find_or_clear<T>(
        &self,
        locked: &mut LockedInterface<'_>,
        mut find: impl FnMut(&mut LockedInterface<'_>) -> Option<T>,
    ) -> Option<T> {
        find(locked).or_else(|| match self.clear(locked) {
            true => find(locked),
            false => None,
        })
    }

    /// Clears the descriptor. Returns whether to look once more.
    pub(crate) fn clear(&self, interface: &mut InterfaceDriver) -> bool {
        if self.polled.get().is_none() {
            return false;
        }
        if self.bell.get().is_some_and(|bell| bell.clear(interface)) {
            #[cfg(feature = "tokio")]
            self.cleared.notify_waiters();
        }
        interface.park();
        true
    }

    /// The descriptor that a program can poll: see [`Bell`]. In a shortage, that of the node, which is then readable:
    /// the program looks for messages, and requests the descriptor again.
    pub(crate) fn descriptor(&self) -> BorrowedFd<'_> {
        self.try_descriptor().unwrap_or_else(|error| {
            self.shared.signal_shortage(&error);
            self.shared.sets.as_fd()
        })
    }

    /// The descriptor that a program can poll. Once this succeeded, it never fails.
    ///
    /// # Errors
    ///
    /// Errors of `epoll_create1(2)`, `epoll_ctl(2)` and `eventfd(2)`.
    pub(crate) fn try_descriptor(&self) -> io::Result<BorrowedFd<'_>> {
        self.polled.get_or_init(|| ());
        loop {
            if let Some(bell) = self.bell.get() {
                return Ok(bell.as_fd());
            }
            if let Err(spare) = self.bell.set(Bell::new(&self.interface)?) {
                // Another thread has made one meanwhile.
                spare.remove(&self.interface);
            }
        }
    }
}

impl Drop for Handle {
    fn drop(&mut self) {
        if self.shared.is_inherited() {
            return;
        }
        if let Some(bell) = self.bell.get() {
            bell.remove(&self.interface);
        }
        let mut control = self.shared.lock_driven();
        control.withdraw(self.interface.id, &self.shared.sets);
    }
}

/// The time `timeout` from now.
pub(crate) fn until(timeout: Option<Duration>) -> Option<Instant> {
    timeout.map(|timeout| sm2_io::clock::now().after(timeout))
}
