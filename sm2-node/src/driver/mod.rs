//! What moves a node: its sockets, the machines behind them, and who waits for what.
//!
//! - [`Shared`] is what all handles of a node share: the epoll set and, under a lock, [`Inner`].
//! - [`Inner::drive`] asks the epoll set what can be read or written now, and does a bounded
//!   amount of it. Every call of a program begins with it.
//! - `session` is the connection with the Manager, `link` one end of one link; each is a
//!   socket and a machine of `sm2-proto`, whose outputs are matched in one place: `control`
//!   and `link`. `reconnect` makes the next connection when one is over, `questions` is what
//!   the program asks the Manager, `counters` what tools can look at.
//! - `interface` holds the links of one publisher, subscriber, server or client; `publish`,
//!   `take` and `calls` are what it does with them; `outbox` holds the messages on their way
//!   out.
//! - `wait` is how threads wait without the lock.

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

/// How many datagrams one socket is read at a time, so that no peer keeps a node busy.
const BURST: usize = 32;
/// How many sockets are looked at in one drive.
const SOCKETS: usize = 64;
/// How long sockets wait to be looked at by who has work without them, on the ring lane.
const SOCKETS_WAIT_NS: u64 = 100_000;
/// The token of the session's socket.
const SESSION: u64 = LinkToken::FIRST.0;
/// The token of the timer of the next attempt to connect.
const TIMER: u64 = LinkToken::LAST.0;

/// What all handles of a node share.
#[derive(Debug)]
pub(crate) struct Shared {
    pub(crate) epoll: Epoll,
    pub(crate) name: Name,
    /// How long the Manager may take to answer.
    pub(crate) manager_timeout: Duration,
    inner: Mutex<Inner>,
    /// Last: it goes when this node has said goodbye to it.
    #[cfg(feature = "embedded-manager")]
    embedded: Option<sm2_manager::Background>,
}

/// What moves, under the lock.
#[derive(Debug)]
pub(crate) struct Inner {
    name: Name,
    /// Whether links offer the ring lane.
    ring_lane: bool,
    session: Session,
    reconnect: Reconnect,
    questions: Questions,
    counting: Counting,
    /// What types look like whose texts this node registers with each Manager.
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
    /// When the sockets were looked at.
    driven: Instant,
    /// The moment of the call that goes on.
    now: Instant,
}

impl Shared {
    /// A node that has greeted the Manager behind `socket`, and will find others at `path`.
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

    /// The node has a Manager of its own, or one that stands by.
    #[cfg(feature = "embedded-manager")]
    pub(crate) fn with_manager(mut self, manager: Option<sm2_manager::Background>) -> Self {
        self.embedded = manager;
        self
    }

    /// The node, as it is. What a thread that panicked left behind is consistent: of a user's
    /// code, only a `tracing` subscriber runs under the lock (and must not call this node).
    pub(crate) fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The node, after it has done what there was to do.
    pub(crate) fn driven(&self) -> MutexGuard<'_, Inner> {
        let mut inner = self.lock();
        inner.drive(&self.epoll);
        inner
    }

    /// Drives the node, and changes one of its interfaces, if it is still there.
    pub(crate) fn with<R>(
        &self,
        interface: InterfaceId,
        change: impl FnOnce(&mut Interface, &mut Tools<'_>) -> R,
    ) -> Option<R> {
        self.driven().with(interface, &self.epoll, change)
    }

    /// The same, but the node is driven only if it is time to, as long as all links have rings.
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

    /// The same without driving it.
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
    /// The same, if that was not done for a while: no system call for each message of a ring.
    /// Whether it was done.
    pub(crate) fn drive_if_due(&mut self, now: Instant, epoll: &Epoll) -> bool {
        self.now = now;
        let due = now.0.saturating_sub(self.driven.0) >= SOCKETS_WAIT_NS;
        if due {
            self.driven = now;
            self.drive(epoll);
        }
        due
    }

    /// Reads what there is to read and sends what can be sent, a bounded amount of it,
    /// without waiting.
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

    /// Takes back what an interface's messages were given back, changes it, and tells the Manager
    /// which of its links are over by that.
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

    /// The same without taking anything back.
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
            // Who spins waits for the end of all links.
            self.sleepers.wake(Topic::Session);
            self.drain_session(Incoming::default(), epoll);
        }
        Some(result)
    }
}
