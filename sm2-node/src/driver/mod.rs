//! The driver of a node: its sockets, the machines behind the sockets, and the threads that wait.
//!
//! - [`Shared`] holds the state that all handles of a node share: the epoll set and, under a lock,
//!   [`Inner`].
//! - [`Inner::drive`] asks the epoll set which sockets are readable or writable, and reads and
//!   writes a bounded amount. Most calls of a program begin with it.
//! - `session` is the connection with the Manager, and `link` is one end of one link. Each is a
//!   socket and a machine of `sm2-proto`. Only `control` and `link::outputs` match the outputs of
//!   these machines.
//! - `reconnect` connects to the next Manager after a session has ended. `questions` holds the
//!   requests of the program to the Manager. `counters` holds the counters that tools can read.
//! - `interface` holds the links of one publisher, subscriber, server or client. `publish`, `take`
//!   and `calls` are its operations. `outbox` holds the messages that are not settled.
//! - `wait` lets threads wait without the lock.

mod calls;
mod control;
mod counters;
mod datagram;
mod interface;
mod lane;
mod link;
mod links;
mod message_key;
mod outbox;
mod publish;
mod questions;
mod reconnect;
mod session;
mod status;
mod take;
mod token;
mod wait;

use std::collections::{BTreeMap, HashMap};
use std::io;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use sm2_io::{Epoll, Event, Events, Interest, Scratch, SeqPacket};
use sm2_proto::limits::DATAGRAM_MAX;
use sm2_proto::node::Input;
use sm2_proto::{Farewell, Instant, InterfaceId, Name, TypeId};

pub(crate) use self::calls::{CallId, Choice, Outcome};
use self::counters::Counting;
use self::datagram::Incoming;
pub(crate) use self::interface::{Interface, State};
pub(crate) use self::link::Tools;
pub(crate) use self::outbox::{Forms, Label, Needs, NoSlot, Reservation, Reserved};
pub(crate) use self::publish::Offered;
use self::questions::Questions;
pub(crate) use self::questions::{Answer, Followed, Lost, Question, Ticket};
use self::reconnect::Reconnect;
pub(crate) use self::reconnect::may_return;
use self::session::Session;
pub use self::status::{LinkStatus, Received};
pub(crate) use self::take::{Full, Taken};
pub(crate) use self::token::LinkToken;
use self::wait::Sleepers;
pub(crate) use self::wait::{Bell, Topic, Until};

/// How many datagrams are read from one socket in one drive, so that no peer keeps a node busy.
const BURST: usize = 32;
/// How many sockets are read or written in one drive.
const SOCKETS: usize = 64;
/// On the ring lane: how long a call that does not need the sockets may leave them unread.
const SOCKETS_WAIT_NS: u64 = 100_000;
/// The token of the session's socket.
const SESSION: u64 = LinkToken::FIRST.0;
/// The token of the timer of the next attempt to connect.
const TIMER: u64 = LinkToken::LAST.0;

/// The state that all handles of a node share.
#[derive(Debug)]
pub(crate) struct Shared {
    pub(crate) epoll: Epoll,
    pub(crate) name: Name,
    /// The timeout for an answer of the Manager.
    pub(crate) manager_timeout: Duration,
    inner: Mutex<Inner>,
    /// The last field, so that the Manager is dropped after this node has closed its session.
    #[cfg(feature = "embedded-manager")]
    embedded: Option<sm2_manager::Background>,
}

/// The state of a node that changes, under the lock.
#[derive(Debug)]
pub(crate) struct Inner {
    name: Name,
    /// Whether links offer the ring lane.
    ring_lane: bool,
    session: Session,
    reconnect: Reconnect,
    questions: Questions,
    counting: Counting,
    /// The schema texts that this node registers with each Manager, by type.
    schemas: BTreeMap<TypeId, String>,
    pub(crate) interfaces: BTreeMap<InterfaceId, Interface>,
    /// The interface that each link belongs to.
    routes: HashMap<LinkToken, InterfaceId>,
    /// The token of the newest link.
    last_token: LinkToken,
    buffer: Scratch,
    events: Events,
    ready: Vec<Event>,
    sleepers: Sleepers,
    /// The time of the last drive.
    driven: Instant,
    /// The time at which the current API call began.
    now: Instant,
}

impl Shared {
    /// Creates a node whose Manager is at the other end of `socket`. The node finds later Managers
    /// at `path`.
    pub(crate) fn new(
        socket: SeqPacket,
        path: PathBuf,
        name: Name,
        manager_timeout: Duration,
        ring_lane: bool,
    ) -> io::Result<Self> {
        let epoll = Epoll::new()?;
        epoll.add(&socket, SESSION, Interest::READABLE)?;
        let mut inner = Inner {
            name: name.clone(),
            ring_lane,
            session: Session::new(socket, name.clone()),
            reconnect: Reconnect::new(path, &epoll)?,
            questions: Questions::default(),
            counting: Counting::default(),
            schemas: BTreeMap::new(),
            interfaces: BTreeMap::new(),
            routes: HashMap::new(),
            last_token: LinkToken::FIRST,
            buffer: Scratch::new(DATAGRAM_MAX)?,
            events: Events::with_capacity(SOCKETS),
            ready: Vec::with_capacity(SOCKETS),
            sleepers: Sleepers::new()?,
            driven: Instant(0),
            now: Instant(0),
        };
        inner.drain_session(Incoming::default(), &epoll);
        Ok(Self {
            epoll,
            name,
            manager_timeout,
            inner: Mutex::new(inner),
            #[cfg(feature = "embedded-manager")]
            embedded: None,
        })
    }

    /// Attaches a Manager that runs in this process, active or standby.
    #[cfg(feature = "embedded-manager")]
    pub(crate) fn with_manager(mut self, manager: Option<sm2_manager::Background>) -> Self {
        self.embedded = manager;
        self
    }

    /// Locks the node. If another thread panicked under the lock, the state is still consistent:
    /// the only user code that runs under the lock is a `tracing` subscriber, which must not call
    /// this node.
    pub(crate) fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Locks the node and drives it.
    pub(crate) fn driven(&self) -> MutexGuard<'_, Inner> {
        let mut inner = self.lock();
        inner.drive(&self.epoll);
        inner
    }

    /// Drives the node and changes one of its interfaces. `None` if the interface does not exist
    /// any more.
    pub(crate) fn with<R>(
        &self,
        interface: InterfaceId,
        change: impl FnOnce(&mut Interface, &mut Tools<'_>) -> R,
    ) -> Option<R> {
        self.driven().with(interface, &self.epoll, change)
    }

    /// The same as [`with`](Self::with), but while all links of the interface have rings, the node
    /// is driven only if its last drive was some time ago.
    pub(crate) fn with_due<R>(
        &self,
        interface: InterfaceId,
        change: impl FnOnce(&mut Interface, &mut Tools<'_>) -> R,
    ) -> Option<R> {
        let now = sm2_io::clock::now();
        let mut inner = self.lock();
        let driven = inner.drive_if_due(now, &self.epoll);
        if !driven && !inner.has_rings_only(Topic::Interface(interface)) {
            inner.drive(&self.epoll);
        }
        inner.with(interface, &self.epoll, change)
    }

    /// The same as [`with`](Self::with), but without driving the node.
    pub(crate) fn with_idle<R>(
        &self,
        interface: InterfaceId,
        change: impl FnOnce(&mut Interface, &mut Tools<'_>) -> R,
    ) -> Option<R> {
        self.lock().with(interface, &self.epoll, change)
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        let inner = self.inner.get_mut().unwrap_or_else(PoisonError::into_inner);
        inner.session.tell(Input::Close(Farewell::Done.code()));
        inner.drain_session(Incoming::default(), &self.epoll);
    }
}

impl Inner {
    /// Drives the node if its last drive was some time ago. This avoids a system call for each
    /// message of a ring. Returns whether the node was driven.
    pub(crate) fn drive_if_due(&mut self, now: Instant, epoll: &Epoll) -> bool {
        self.now = now;
        let due = now.0.saturating_sub(self.driven.0) >= SOCKETS_WAIT_NS;
        if due {
            self.driven = now;
            self.drive(epoll);
        }
        due
    }

    /// Reads from readable sockets and writes to writable ones. Does a bounded amount of work and
    /// does not wait.
    pub(crate) fn drive(&mut self, epoll: &Epoll) {
        if let Err(error) = epoll.wait(&mut self.events, Some(Duration::ZERO)) {
            tracing::error!(%error, "cannot ask for events");
            return;
        }
        self.ready.extend(self.events.iter());
        while let Some(event) = self.ready.pop() {
            if event.token == SESSION {
                self.on_session_event(event, epoll);
                continue;
            }
            if event.token == TIMER {
                self.on_timer(epoll);
                continue;
            }
            let token = LinkToken(event.token);
            if let Some(&interface) = self.routes.get(&token) {
                self.with(interface, epoll, |interface, tools| {
                    interface.on_event(token, event, tools);
                });
                self.sleepers.wake(Topic::Interface(interface));
            }
        }
    }

    /// Harvests the messages that came back to an interface, changes the interface, and tells the
    /// Manager which of its links have ended.
    pub(crate) fn with<R>(
        &mut self,
        id: InterfaceId,
        epoll: &Epoll,
        change: impl FnOnce(&mut Interface, &mut Tools<'_>) -> R,
    ) -> Option<R> {
        self.with_as_is(id, epoll, |interface, tools| {
            interface.harvest(tools);
            change(interface, tools)
        })
    }

    /// The same as [`with`](Self::with), but without harvesting.
    pub(crate) fn with_as_is<R>(
        &mut self,
        id: InterfaceId,
        epoll: &Epoll,
        change: impl FnOnce(&mut Interface, &mut Tools<'_>) -> R,
    ) -> Option<R> {
        let interface = self.interfaces.get_mut(&id)?;
        let mut tools = Tools {
            epoll,
            buffer: &mut self.buffer,
            counting: &mut self.counting,
            now: self.now,
            stirred: false,
        };
        let result = change(interface, &mut tools);
        if tools.stirred {
            self.sleepers.wake(Topic::Interface(id));
        }
        for token in interface.gone.drain(..) {
            self.routes.remove(&token);
        }
        if !interface.farewells.is_empty() {
            for (link, code) in std::mem::take(&mut interface.farewells) {
                self.session.unlinked(id, link, code);
            }
            // A thread that spins waits for the end of all links.
            self.sleepers.wake(Topic::Session);
            self.drain_session(Incoming::default(), epoll);
        }
        Some(result)
    }
}
