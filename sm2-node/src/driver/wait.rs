//! Waiting without a lock.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::time::Duration;

use sm2_io::Waker;
use sm2_proto::Instant;

use super::context::Context;
use super::control::Control;
use super::interface::DeclaredInterface;
use super::shared_interface::{Drive, LockedInterface, SharedInterface};
use super::shared_node::NodeState;
use super::sleep::sleep;
use crate::Wait;

/// The reason why a wait ended before its time, without a result.
#[derive(Debug)]
pub(crate) enum WaitFailure {
    /// The program requested a shutdown.
    Shutdown,
    /// `eventfd(2)` or `ppoll(2)` failed: too many descriptors, or no memory.
    Io(io::Error),
}

impl From<io::Error> for WaitFailure {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

/// How many pauses of the processor a spinning thread makes between two uses of the lock.
const PAUSES: u32 = 4;

/// The end of a wait.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Until {
    /// No end.
    Forever,
    /// The wait ends at this time.
    At(Instant),
    /// The wait ends after this time. `wait` adds the time of its own clock reading, which saves a
    /// second reading.
    In(Duration),
}

impl Until {
    /// An end that has passed already.
    pub(crate) const NOW: Self = Self::At(Instant(0));

    /// Whether this end has not passed already.
    pub(crate) const fn waits(self) -> bool {
        !matches!(self, Self::At(Instant(0)))
    }

    pub(crate) fn moment(self, now: Instant) -> Option<Instant> {
        match self {
            Self::Forever => None,
            Self::At(moment) => Some(moment),
            Self::In(time) => Some(now.after(time)),
        }
    }
}

impl From<Option<Instant>> for Until {
    fn from(until: Option<Instant>) -> Self {
        until.map_or(Self::Forever, Self::At)
    }
}

impl From<Option<Duration>> for Until {
    fn from(timeout: Option<Duration>) -> Self {
        timeout.map_or(Self::Forever, Self::In)
    }
}

impl NodeState {
    /// Drives the control side until `look` finds something or `until` has passed. Without `until`, waits as long as it
    /// takes. `look` is called at least once, under the node's lock. The lock is not held while the thread sleeps.
    ///
    /// # Errors
    ///
    /// See [`WaitFailure`].
    pub(crate) fn wait<T>(
        &self,
        until: Option<Instant>,
        mut look: impl FnMut(&mut Control) -> Option<T>,
    ) -> Result<Option<T>, WaitFailure> {
        loop {
            let mut control = self.lock_driven();
            if let Some(found) = look(&mut control) {
                return Ok(Some(found));
            }
            let now = sm2_io::clock::now();
            if until.is_some_and(|until| until <= now) {
                return Ok(None);
            }
            if self.sets.is_shut_down() {
                return Err(WaitFailure::Shutdown);
            }
            let waker = control.sleepers.enter()?;
            let short_of_memory = control.short_of_memory;
            drop(control);
            let sets = [self.sets.control.as_fd()];
            let timeout = until.map(|until| until.since(now));
            let waited = sleep(
                &sets,
                Some(&waker),
                self.sets.shutdown(),
                short_of_memory,
                timeout,
            );
            self.lock().sleepers.leave(&waker);
            waited?;
        }
    }

    /// Waits until the node's descriptor is readable, or a ring has a message, for at most `timeout`.
    ///
    /// # Errors
    ///
    /// Errors of `ppoll(2)`.
    pub(crate) fn wait_once(&self, timeout: Option<Duration>) -> io::Result<()> {
        let control = self.lock();
        let mut short_of_memory = control.short_of_memory;
        // A message in a ring also ends the wait, but only its subscriber can take the message.
        let mut may_take = false;
        for interface in control.interfaces.values() {
            let (interface_may_take, is_short) = interface.park_for_program();
            may_take |= interface_may_take;
            short_of_memory |= is_short;
        }
        drop(control);
        if may_take {
            return Ok(());
        }
        let sets = [self.sets.as_fd()];
        let shutdown = self.sets.shutdown();
        sleep(&sets, None, shutdown, short_of_memory, timeout)
    }

    /// Notes that there was no memory or descriptor for a program that polls an interface. The node's descriptor
    /// becomes readable, so that the program tries again.
    //= SM2-TRN-013
    pub(crate) fn signal_shortage(&self, error: &io::Error) {
        let mut control = self.lock();
        control.not_ready(error);
        control.sleepers.wake();
    }

    /// Does the work of all pending events, also those of the interfaces' links.
    pub(crate) fn drive_all(&self) {
        let mut control = self.lock_driven();
        control.sleepers.clear(&self.changed);
        let ready = control.ready_interfaces(&self.sets);
        drop(control);
        for interface in ready {
            interface.drive();
        }
    }
}

impl SharedInterface {
    /// Drives the interface until `look` finds something or `until` has passed. Without `until`, waits as long as it
    /// takes. `look` is called at least once, under the interface's lock. The lock is not held while the thread sleeps.
    ///
    /// # Errors
    ///
    /// The same as those of [`NodeState::wait`].
    pub(crate) fn wait<T>(
        &self,
        until: Option<Instant>,
        look: impl FnMut(&mut DeclaredInterface, &mut Context<'_>) -> Option<T>,
    ) -> Result<Option<T>, WaitFailure> {
        let mut look = look;
        self.wait_as(Wait::Park, until.into(), |locked| locked.change(&mut look))
    }

    /// The same as [`wait`](Self::wait), with a choice of how to wait: sleep at once, or spin
    /// first.
    ///
    /// # Errors
    ///
    /// The same as those of [`NodeState::wait`].
    pub(crate) fn wait_as<T>(
        &self,
        way: Wait,
        until: Until,
        mut look: impl FnMut(&mut LockedInterface<'_>) -> Option<T>,
    ) -> Result<Option<T>, WaitFailure> {
        let mut now = sm2_io::clock::now();
        let until = until.moment(now);
        let spin_until = match way {
            Wait::Park => Instant(0),
            Wait::SpinThenPark(time) => now.after(time),
            Wait::Spin => Instant(u64::MAX),
        };
        let mut locked = self.enter_at(now, Drive::IfDue);
        loop {
            if let Some(found) = look(&mut locked) {
                return Ok(Some(found));
            }
            if self.sets.is_shut_down() && until.is_none_or(|until| now < until) {
                return Err(WaitFailure::Shutdown);
            }
            if now < spin_until.min(until.unwrap_or(spin_until)) && locked.has_rings_only() {
                // Threads that wait for the lock can take it meanwhile.
                let next_words = locked.next_words();
                drop(locked);
                next_words.spin(PAUSES);
                (locked, now) = self.enter_prefetched();
                continue;
            }
            // No ring has brought anything, so the sockets are read.
            if !locked.is_driven {
                drop(locked);
                locked = self.enter(Drive::Yes);
                if let Some(found) = look(&mut locked) {
                    return Ok(Some(found));
                }
            }
            if until.is_some_and(|until| until <= now) {
                return Ok(None);
            }
            if now < spin_until {
                drop(locked);
                (locked, now) = self.enter_prefetched();
                continue;
            }
            //= SM2-RNG-012
            locked.park();
            if let Some(found) = look(&mut locked) {
                return Ok(Some(found));
            }
            let waker = locked.sleepers.enter()?;
            let short_of_memory = locked.short_of_memory;
            drop(locked);
            let timeout = until.map(|until| until.since(now));
            let waited = self.sleep(&waker, short_of_memory, timeout);
            self.lock().sleepers.leave(&waker);
            waited?;
            (locked, now) = self.enter_prefetched();
        }
    }

    fn sleep(
        &self,
        waker: &Waker,
        short_of_memory: bool,
        timeout: Option<Duration>,
    ) -> io::Result<()> {
        let calls = self.sets.calls.as_fd();
        let control = self.sets.control().as_fd();
        let sets: &[BorrowedFd<'_>] = match self.sets.has_background() {
            true => &[calls],
            false => &[calls, control],
        };
        let shutdown = self.sets.shutdown();
        sleep(sets, Some(waker), shutdown, short_of_memory, timeout)
    }
}
