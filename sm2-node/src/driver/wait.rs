//! Threads that wait, and how one thread wakes another for which it received something.
//!
//! A node has no thread of its own: each thread that calls the node drives all of its sockets.
//! While one thread sleeps until its message comes, another thread may read that message from the
//! socket. A sleeping thread therefore waits for two descriptors: the node's epoll set
//! (level-triggered), and a waker of its own. A thread that drives the node signals the waker when
//! an event concerns the topic that the sleeper has named. A sleeper registers its topic under the
//! node's lock, after it has looked and found nothing, so it misses no event.
//!
//! A descriptor that a program polls in its own loop ([`Bell`]) is a sleeper that stays registered.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
use std::time::Duration;

use sm2_io::{Epoll, Interest, Waker, wait_readable};
use sm2_proto::{Instant, InterfaceId};

use super::{Inner, Shared};
use crate::Wait;

/// How many pauses of the processor a spinning thread makes between two uses of the lock.
const PAUSES: u32 = 4;

/// The events for which a sleeper waits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Topic {
    /// All events of this interface and its links, and the end of the session.
    Interface(InterfaceId),
    /// The session with the Manager.
    Session,
}

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

/// All registered sleepers.
#[derive(Debug)]
pub(super) struct Sleepers {
    all: Vec<Sleeper>,
    /// Wakers that no sleeper uses now.
    spare: Vec<Arc<Waker>>,
}

#[derive(Debug)]
struct Sleeper {
    topic: Topic,
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

    /// Wakes the sleepers of this topic. [`Topic::Session`] wakes all.
    pub(super) fn wake(&mut self, topic: Topic) {
        for sleeper in &mut self.all {
            if !sleeper.woken && (sleeper.topic == topic || topic == Topic::Session) {
                sleeper.woken = true;
                sleeper.waker.wake();
            }
        }
    }

    fn enter(&mut self, topic: Topic) -> io::Result<Arc<Waker>> {
        let waker = match self.spare.pop() {
            Some(waker) => waker,
            None => Arc::new(Waker::new()?),
        };
        self.all.push(Sleeper {
            topic,
            waker: Arc::clone(&waker),
            woken: false,
        });
        Ok(waker)
    }

    fn leave(&mut self, waker: &Arc<Waker>) {
        self.calm(waker);
        self.all.retain(|it| !Arc::ptr_eq(&it.waker, waker));
        self.spare.push(Arc::clone(waker));
    }

    /// Notes that the sleeper has seen all events until now. Returns whether it was woken for one.
    fn calm(&mut self, waker: &Arc<Waker>) -> bool {
        let sleeper = self.all.iter_mut().find(|it| Arc::ptr_eq(&it.waker, waker));
        let Some(sleeper) = sleeper.filter(|it| it.woken) else {
            return false;
        };
        sleeper.woken = false;
        sleeper.waker.drain();
        true
    }
}

impl Shared {
    /// Drives the node until `look` finds something or `until` has passed. Without `until`, waits
    /// as long as it takes. `look` is called at least once, under the lock. The lock is not held
    /// while the thread sleeps.
    ///
    /// # Errors
    ///
    /// Errors of `eventfd(2)` and `ppoll(2)`: too many descriptors, or no memory.
    pub(crate) fn wait<T>(
        &self,
        topic: Topic,
        until: Option<Instant>,
        look: impl FnMut(&mut Inner) -> Option<T>,
    ) -> io::Result<Option<T>> {
        self.wait_as(Wait::Park, topic, until.into(), look)
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
        topic: Topic,
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
            let driven = inner.drive_if_due(now, &self.epoll);
            if let Some(found) = look(&mut inner) {
                return Ok(Some(found));
            }
            if now < spin_until.min(until.unwrap_or(spin_until)) && inner.has_rings_only(topic) {
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
                inner.drive(&self.epoll);
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
            if inner.park(topic)
                && let Some(found) = look(&mut inner)
            {
                return Ok(Some(found));
            }
            let waker = inner.sleepers.enter(topic)?;
            drop(inner);
            let fds = [self.epoll.as_fd(), waker.as_fd()];
            let waited = wait_readable(&fds, until.map(|until| until.since(now)));
            self.lock().sleepers.leave(&waker);
            waited?;
            now = sm2_io::clock::now();
        }
    }
}

impl Inner {
    /// Prepares for a sleep until this topic has an event. Returns whether the caller has to look
    /// once more before it sleeps.
    pub(crate) fn park(&mut self, topic: Topic) -> bool {
        match topic {
            Topic::Interface(id) => {
                if let Some(interface) = self.interfaces.get_mut(&id) {
                    interface.park();
                }
                true
            }
            Topic::Session => false,
        }
    }

    /// Prepares for a sleep until this node has any event. Returns whether a ring already has a
    /// message.
    pub(crate) fn park_all(&mut self) -> bool {
        let mut ready = false;
        for interface in self.interfaces.values_mut() {
            interface.park();
            ready |= interface.is_ready();
        }
        ready
    }

    /// Whether all messages of this topic come through rings, so that the sockets need to be read
    /// only from time to time.
    pub(super) fn has_rings_only(&self, topic: Topic) -> bool {
        match topic {
            Topic::Interface(id) => self.interfaces.get(&id).is_some_and(|interface| {
                interface.open_links() > 0
                    && interface
                        .links()
                        .all(|it| !it.is_woken_by_socket() || !it.is_open())
            }),
            Topic::Session => false,
        }
    }
}

/// A descriptor that becomes readable when an interface may have an event: an epoll set that
/// contains the node's epoll set and a waker.
#[derive(Debug)]
pub(crate) struct Bell {
    set: Epoll,
    waker: Arc<Waker>,
}

impl Bell {
    /// Creates a bell that is already signalled, because there may already be something to take.
    pub(crate) fn new(shared: &Shared, interface: InterfaceId) -> io::Result<Self> {
        let set = Epoll::new()?;
        set.add(&shared.epoll, 0, Interest::READABLE)?;
        let mut inner = shared.lock();
        let topic = Topic::Interface(interface);
        let waker = inner.sleepers.enter(topic)?;
        let bell = Self { set, waker };
        if let Err(error) = bell.set.add(&*bell.waker, 1, Interest::READABLE) {
            inner.sleepers.leave(&bell.waker);
            return Err(error);
        }
        inner.sleepers.wake(topic);
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
