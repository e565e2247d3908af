//! Threads that wait, and how they learn of what another thread received for them.
//!
//! A node has no thread of its own: whoever calls it moves all of its sockets on. So
//! while one thread sleeps, waiting for its message, another may be the one
//! that reads it from the socket. A sleeping thread therefore waits for two things: the
//! node's sockets (the epoll set, level-triggered), and a waker of its own, which
//! whoever drives the node pulls when something happened to the interface that the
//! sleeper named. Sleepers enter their name under the node's lock, after they found
//! nothing, so nothing can happen in between unseen.
//!
//! Descriptors that a program polls in a loop of its own ([`Bell`]) are sleepers
//! that never leave.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
use std::time::Duration;

use sm2_io::{Epoll, Interest, Waker, wait_readable};
use sm2_proto::{Instant, InterfaceId};

use super::{Inner, Shared};
use crate::Wait;

/// How long a spinning thread leaves the lock alone, in pauses of the processor.
const PAUSES: u32 = 4;

/// What a sleeper waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Topic {
    /// Anything that happens to this interface or its links, and the end of the session.
    Interface(InterfaceId),
    /// The session with the Manager.
    Session,
}

/// How long to wait.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Until {
    /// As long as it takes.
    Forever,
    /// Not longer than to this moment.
    At(Instant),
    /// Not longer than this. Whoever waits reads the clock anyway: so that it is read once.
    In(Duration),
}

impl Until {
    /// The time is over already.
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

/// All who sleep.
#[derive(Debug)]
pub(super) struct Sleepers {
    all: Vec<Sleeper>,
    /// Wakers that nobody uses at the moment.
    spare: Vec<Arc<Waker>>,
}

#[derive(Debug)]
struct Sleeper {
    topic: Topic,
    waker: Arc<Waker>,
    woken: bool,
}

impl Sleepers {
    /// Nobody, and a waker for the first who comes.
    pub(super) fn new() -> io::Result<Self> {
        Ok(Self {
            all: Vec::new(),
            spare: vec![Arc::new(Waker::new()?)],
        })
    }

    /// Something happened.
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

    /// The sleeper has seen all that happened up to now; whether anything did.
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
    /// Drives the node until `look` finds what it wants, or `until` has come; without `until`,
    /// as long as it takes. `look` is asked at least once, under the lock; the waiting
    /// happens outside of it.
    ///
    /// # Errors
    ///
    /// Whatever `eventfd(2)` and `ppoll(2)` say: too many descriptors, no memory.
    pub(crate) fn wait<T>(
        &self,
        topic: Topic,
        until: Option<Instant>,
        look: impl FnMut(&mut Inner) -> Option<T>,
    ) -> io::Result<Option<T>> {
        self.wait_as(Wait::Park, topic, until.into(), look)
    }

    /// The same in another way than to sleep at once.
    ///
    /// # Errors
    ///
    /// As [`wait`](Self::wait).
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
                // Others who wait for the lock get it.
                for _ in 0..PAUSES {
                    std::hint::spin_loop();
                }
                now = sm2_io::clock::now();
                continue;
            }
            // Nothing came by a ring: perhaps by a socket.
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
    /// Whoever waits for this is about to sleep; whether it has to look once more before.
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

    /// Somebody is about to sleep until anything happens to this node; whether there is a
    /// message in a ring already.
    pub(crate) fn park_all(&mut self) -> bool {
        let mut ready = false;
        for interface in self.interfaces.values_mut() {
            interface.park();
            ready |= interface.is_ready();
        }
        ready
    }

    /// Whether all that is waited for comes by rings, so that sockets need a look only now and
    /// then.
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

/// A descriptor that becomes readable when an interface may have something new: an epoll
/// set of the node's own set and a waker.
#[derive(Debug)]
pub(crate) struct Bell {
    set: Epoll,
    waker: Arc<Waker>,
}

impl Bell {
    /// Rung at first, since there may be something already.
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

    /// Nothing is there any more: readable again when something comes. Whether it was rung.
    pub(crate) fn silence(&self, inner: &mut Inner) -> bool {
        inner.sleepers.calm(&self.waker)
    }

    /// Nobody polls it any more.
    pub(crate) fn remove(&self, inner: &mut Inner) {
        inner.sleepers.leave(&self.waker);
    }
}

impl AsFd for Bell {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.set.as_fd()
    }
}
