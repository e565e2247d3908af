//! Waiting without the node's lock.

use std::io;
use std::os::fd::AsFd;
use std::thread;
use std::time::Duration;

use sm2_io::{Waker, is_shortage, wait_readable};
use sm2_proto::Instant;

use super::Inner;
use super::limits::SHORTAGE_PAUSE;
use super::shared_node::NodeState;
use super::sleepers::EventSource;
use crate::Wait;

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

    fn moment(self, now: Instant) -> Option<Instant> {
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
    /// Drives the node until `look` finds something or `until` has passed. Without `until`, waits
    /// as long as it takes. `look` is called at least once, under the lock. The lock is not held
    /// while the thread sleeps.
    ///
    /// # Errors
    ///
    /// Errors of `eventfd(2)` and `ppoll(2)`: too many descriptors, or no memory.
    pub(crate) fn wait<T>(
        &self,
        source: EventSource,
        until: Option<Instant>,
        look: impl FnMut(&mut Inner) -> Option<T>,
    ) -> io::Result<Option<T>> {
        self.wait_as(Wait::Park, source, until.into(), look)
    }

    /// The same as [`wait`](Self::wait), with a choice of how to wait: sleep at once, or spin
    /// first.
    ///
    /// # Errors
    ///
    /// The same as those of [`wait`](Self::wait).
    pub(crate) fn wait_as<T>(
        &self,
        way: Wait,
        source: EventSource,
        until: Until,
        mut look: impl FnMut(&mut Inner) -> Option<T>,
    ) -> io::Result<Option<T>> {
        let mut now = sm2_io::clock::now();
        let until = until.moment(now);
        let spin_until = match way {
            Wait::Park => Instant(0),
            Wait::SpinThenPark(time) => now.after(time),
            Wait::Spin => Instant(u64::MAX),
        };
        loop {
            let mut inner = self.lock();
            let driven = inner.drive_if_due(now, &self.sets);
            if let Some(found) = look(&mut inner) {
                return Ok(Some(found));
            }
            if now < spin_until.min(until.unwrap_or(spin_until)) && inner.has_rings_only(source) {
                drop(inner);
                // Threads that wait for the lock can take it during the pauses.
                for _ in 0..PAUSES {
                    std::hint::spin_loop();
                }
                now = sm2_io::clock::now();
                continue;
            }
            // No ring has brought anything, so the sockets are read.
            if !driven {
                inner.drive(&self.sets);
                if let Some(found) = look(&mut inner) {
                    return Ok(Some(found));
                }
            }
            if until.is_some_and(|until| until <= now) {
                return Ok(None);
            }
            if now < spin_until {
                now = sm2_io::clock::now();
                continue;
            }
            //= SM2-RNG-009
            if inner.park(source)
                && let Some(found) = look(&mut inner)
            {
                return Ok(Some(found));
            }
            let waker = inner.sleepers.enter(source)?;
            let short_of_memory = inner.short_of_memory;
            drop(inner);
            let timeout = until.map(|until| until.since(now));
            let waited = self.sleep(Some(&waker), short_of_memory, timeout);
            self.lock().sleepers.leave(&waker);
            waited?;
            now = sm2_io::clock::now();
        }
    }
}

impl NodeState {
    /// Waits until a socket or a timer is ready, or a ring has a message, for at most `timeout`.
    ///
    /// # Errors
    ///
    /// Errors of `ppoll(2)`.
    pub(crate) fn wait_once(&self, timeout: Option<Duration>) -> io::Result<()> {
        let mut inner = self.lock();
        // A message in a ring also ends the wait, but only its subscriber can take the message.
        if inner.park_all() {
            return Ok(());
        }
        let short_of_memory = inner.short_of_memory;
        drop(inner);
        self.sleep(None, short_of_memory, timeout)
    }

    /// Sleeps until a socket is ready, another thread signals `waker`, or the timeout. If the kernel has no memory
    /// for a socket that is ready, pauses instead, but not after a signal.
    //= SM2-TRN-014
    fn sleep(
        &self,
        waker: Option<&Waker>,
        short_of_memory: bool,
        timeout: Option<Duration>,
    ) -> io::Result<()> {
        let pause = timeout.map_or(SHORTAGE_PAUSE, |it| it.min(SHORTAGE_PAUSE));
        let waker = waker.map(AsFd::as_fd);
        let waited = match (short_of_memory, waker) {
            (true, waker) => wait_readable(waker.as_slice(), Some(pause)),
            (false, Some(waker)) => wait_readable(&[self.sets.as_fd(), waker], timeout),
            (false, None) => wait_readable(&[self.sets.as_fd()], timeout),
        };
        match waited {
            Err(error) if is_shortage(&error) => {
                thread::sleep(pause);
                Ok(())
            }
            waited => waited.map(drop),
        }
    }

    /// The background thread sleeps until the control side has an event, or `stop` is signalled. If the kernel had no
    /// memory for the last event, pauses instead.
    //= SM2-TRN-014
    pub(super) fn sleep_for_control(&self, stop: &Waker, short_of_memory: bool) {
        let waited = match short_of_memory {
            true => wait_readable(&[stop.as_fd()], Some(SHORTAGE_PAUSE)),
            false => wait_readable(&[self.sets.control.as_fd(), stop.as_fd()], None),
        };
        if waited.is_err() {
            thread::sleep(SHORTAGE_PAUSE);
        }
    }
}

impl Inner {
    /// Prepares for a sleep until this source has an event. Returns whether the caller has to look
    /// once more before it sleeps.
    pub(crate) fn park(&mut self, source: EventSource) -> bool {
        match source {
            EventSource::Interface(id) => {
                if let Some(interface) = self.interfaces.get_mut(&id) {
                    interface.park();
                }
                true
            }
            EventSource::Session => false,
        }
    }

    /// Prepares for a sleep until this node has any event. Returns whether a ring may already have a
    /// message.
    pub(crate) fn park_all(&mut self) -> bool {
        let mut may_take = false;
        for interface in self.interfaces.values_mut() {
            interface.park();
            may_take |= interface.may_take();
        }
        may_take
    }

    /// Whether all messages of this source come through rings and no link is opening, so that the sockets need to
    /// be read only from time to time.
    pub(super) fn has_rings_only(&self, source: EventSource) -> bool {
        match source {
            EventSource::Interface(id) => self.interfaces.get(&id).is_some_and(|interface| {
                interface.open_links() > 0
                    && interface
                        .links()
                        .all(|it| !it.is_woken_by_socket() || it.end().is_some())
            }),
            EventSource::Session => false,
        }
    }
}
