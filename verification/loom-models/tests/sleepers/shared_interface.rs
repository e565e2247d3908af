//! Models `sm2-node/src/driver/shared_interface.rs`.

use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};
use std::sync::Arc;

use loom::sync::{Mutex, MutexGuard};
use sm2_proto::Instant;

use super::context::Context;
use super::interface::DeclaredInterface;
use crate::kernel::{BorrowedFd, Epoll};

use super::super::sleepers::Sleepers;
use super::sleepers;

#[derive(Debug)]
pub(crate) struct SharedInterface {
    pub(crate) sets: LinkSets,
    driver: Mutex<InterfaceDriver>,
}

#[derive(Debug)]
pub(crate) struct LinkSets {
    pub(crate) calls: Epoll,
    control: Epoll,
    /// The node; these models know nothing of it.
    pub(crate) node: (),
}

#[derive(Debug)]
pub(crate) struct InterfaceDriver {
    pub(super) interface: DeclaredInterface,
    pub(in super::super) sleepers: Sleepers,
    pub(crate) is_driven: bool,
    /// Memory is never short in these models.
    pub(crate) short_of_memory: bool,
}

/// The words that a spinning thread watches.
pub(crate) struct NextWords;

/// Whether a call reads the sockets first.
pub(crate) enum Drive {
    Yes,
    IfDue,
}

pub(crate) struct LockedInterface<'a>(MutexGuard<'a, InterfaceDriver>);

impl LinkSets {
    /// The control side is a thread of its own.
    pub(crate) const fn has_background(&self) -> bool {
        true
    }

    /// No thread requests a shutdown here.
    pub(crate) const fn is_shut_down(&self) -> bool {
        false
    }

    pub(crate) const fn shutdown(&self) -> Option<BorrowedFd<'_>> {
        None
    }

    pub(crate) const fn control(&self) -> &Epoll {
        &self.control
    }
}

impl SharedInterface {
    pub(super) fn new(interface: DeclaredInterface) -> Arc<Self> {
        Arc::new(Self {
            sets: LinkSets {
                calls: Epoll::new().unwrap(),
                control: Epoll::new().unwrap(),
                node: (),
            },
            driver: Mutex::new(InterfaceDriver {
                interface,
                sleepers: sleepers(),
                is_driven: false,
                short_of_memory: false,
            }),
        })
    }

    pub(crate) fn lock(&self) -> LockedInterface<'_> {
        LockedInterface(self.driver.lock().unwrap())
    }

    pub(crate) fn enter(&self, drive: Drive) -> LockedInterface<'_> {
        self.enter_at(Instant(0), drive)
    }

    /// Never due in these models: in this case the sockets are read least.
    pub(crate) fn enter_at(&self, _: Instant, drive: Drive) -> LockedInterface<'_> {
        let mut locked = self.lock();
        locked.0.is_driven = matches!(drive, Drive::Yes);
        if locked.0.is_driven {
            locked.drive();
        }
        locked
    }

    pub(crate) fn enter_prefetched(&self) -> (LockedInterface<'_>, Instant) {
        (self.enter(Drive::IfDue), Instant(0))
    }

    pub(crate) fn drive(&self) {
        self.lock().drive();
    }

    pub(crate) fn park_for_program(&self) -> (bool, bool) {
        self.lock().park();
        (false, false)
    }

    /// The background thread changes the interface.
    pub(super) fn change_from_control(&self, change: impl FnOnce(&mut DeclaredInterface)) {
        let mut locked = self.lock();
        change(&mut locked.0.interface);
        locked.0.sleepers.wake();
    }

}

impl LockedInterface<'_> {
    pub(crate) fn drive_at(&mut self, _: Instant) {
        self.drive();
    }

    pub(crate) fn drive(&mut self) {
        if self.0.interface.read() {
            self.0.sleepers.wake();
        }
    }

    pub(crate) fn change<R>(
        &mut self,
        change: impl FnOnce(&mut DeclaredInterface, &mut Context<'_>) -> R,
    ) -> R {
        change(&mut self.0.interface, &mut Context(PhantomData))
    }

    /// No thread spins in these models.
    pub(crate) fn has_rings_only(&self) -> bool {
        false
    }

    pub(crate) const fn next_words(&self) -> NextWords {
        NextWords
    }
}

impl NextWords {
    pub(crate) const fn spin(&self, _pauses: u32) -> bool {
        false
    }
}

impl InterfaceDriver {
    pub(crate) fn park(&mut self) {
        self.interface.park();
    }
}

impl Deref for LockedInterface<'_> {
    type Target = InterfaceDriver;

    fn deref(&self) -> &InterfaceDriver {
        &self.0
    }
}

impl DerefMut for LockedInterface<'_> {
    fn deref_mut(&mut self) -> &mut InterfaceDriver {
        &mut self.0
    }
}
