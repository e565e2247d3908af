//! What moves a node: its sockets, the machines behind them, and who waits for what.
//!
//! - [`Shared`] is what all handles of a node share: the epoll set and, under a lock, [`Inner`].
//! - [`Inner::drive`] asks the epoll set what can be read or written now, and does a bounded
//!   amount of it. Every call of a program begins with it.
//! - `session` is the connection with the Manager, `link` one end of one link; each is a
//!   socket and a machine of `sm2-proto`, and the only place where that machine's outputs
//!   are matched. `interface` holds the links of one publisher, subscriber, server or
//!   client; `publish`, `take` and `calls` are what it does with them; `outbox` holds the
//!   messages on their way out.
//! - `wait` is how threads wait without the lock.

mod calls;
mod datagram;
mod interface;
mod link;
mod outbox;
mod publish;
mod session;
mod status;
mod take;
mod wait;

use std::collections::{BTreeMap, HashMap};
use std::io;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use sm2_io::{Epoll, Event, Events, Interest, SeqPacket};
use sm2_proto::control::Peer;
use sm2_proto::limits::DATAGRAM_MAX;
use sm2_proto::link::Config;
use sm2_proto::node::{self, End, Input, Output};
use sm2_proto::{Contract, Farewell, InterfaceId, LinkId, Name};

pub(crate) use self::calls::{CallId, Choice, Outcome};
use self::datagram::Incoming;
pub(crate) use self::interface::{Interface, State};
use self::link::LinkDriver;
pub(crate) use self::link::Tools;
pub(crate) use self::outbox::{Forms, Label, Needs, NoSlot, seal};
use self::session::Session;
pub(crate) use self::session::{Greeting, Page};
pub use self::status::LinkStatus;
pub(crate) use self::take::{Full, Taken};
use self::wait::Sleepers;
pub(crate) use self::wait::{Bell, Topic};

/// How many datagrams one socket is read at a time, so that no peer keeps a node busy.
const BURST: usize = 32;
/// How many sockets are looked at in one drive.
const SOCKETS: usize = 64;
/// The session's token; those of links count from 1.
const SESSION: u64 = 0;

/// What all handles of a node share.
#[derive(Debug)]
pub(crate) struct Shared {
    pub(crate) epoll: Epoll,
    pub(crate) name: Name,
    /// How long the Manager may take to answer.
    pub(crate) patience: Duration,
    inner: Mutex<Inner>,
    /// One query at a time: pages carry no number.
    pub(crate) querying: Mutex<()>,
}

/// What moves, under the lock.
#[derive(Debug)]
pub(crate) struct Inner {
    session: Session,
    pub(crate) interfaces: BTreeMap<InterfaceId, Interface>,
    /// Which interface a link belongs to, by the link's token.
    routes: HashMap<u64, InterfaceId>,
    last_token: u64,
    buffer: Box<[u8]>,
    events: Events,
    ready: Vec<Event>,
    sleepers: Sleepers,
}

impl Shared {
    /// A node that has greeted the Manager behind `socket`.
    pub(crate) fn new(socket: SeqPacket, name: Name, patience: Duration) -> io::Result<Self> {
        let epoll = Epoll::new()?;
        epoll.add(&socket, SESSION, Interest::READABLE)?;
        let mut inner = Inner {
            session: Session::new(socket, name.clone()),
            interfaces: BTreeMap::new(),
            routes: HashMap::new(),
            last_token: SESSION,
            buffer: vec![0; DATAGRAM_MAX].into(),
            events: Events::with_capacity(SOCKETS),
            ready: Vec::with_capacity(SOCKETS),
            sleepers: Sleepers::new()?,
        };
        inner.drain_session(Incoming::default(), &epoll);
        Ok(Self {
            epoll,
            name,
            patience,
            inner: Mutex::new(inner),
            querying: Mutex::new(()),
        })
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
            } else if let Some(&interface) = self.routes.get(&event.token) {
                self.with(interface, epoll, |interface, tools| {
                    interface.on_event(event.token, event, tools);
                });
                self.sleepers.wake(Topic::Interface(interface));
            }
        }
    }

    /// Changes an interface, and tells the Manager which of its links are over by that.
    pub(crate) fn with<R>(
        &mut self,
        id: InterfaceId,
        epoll: &Epoll,
        change: impl FnOnce(&mut Interface, &mut Tools<'_>) -> R,
    ) -> Option<R> {
        let interface = self.interfaces.get_mut(&id)?;
        let mut tools = Tools {
            epoll,
            buffer: &mut self.buffer,
        };
        let result = change(interface, &mut tools);
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

    fn on_session_event(&mut self, event: Event, epoll: &Epoll) {
        if event.writable {
            self.session.flush(epoll);
        }
        if event.readable {
            for _ in 0..BURST {
                match self.session.receive(&mut self.buffer) {
                    Some(incoming) => self.drain_session(incoming, epoll),
                    None => break,
                }
            }
        }
    }

    /// Does all that the session's machine says: the one place where its outputs are matched.
    fn drain_session(&mut self, mut came: Incoming, epoll: &Epoll) {
        while let Some(output) = self.session.poll() {
            match output {
                Output::Transmit(frame) => self.session.send(frame, epoll),
                Output::Welcomed { .. } => self.greeted(Greeting::Welcomed),
                Output::HelloRefused(reason) => self.greeted(Greeting::Refused(reason)),
                Output::Declared { interface, matches } => {
                    self.answered(interface, State::Live { matches });
                }
                Output::DeclareRefused { interface, reason } => {
                    self.answered(interface, State::Refused(reason));
                }
                Output::Linked {
                    interface,
                    link,
                    version,
                    reliable,
                    sealed,
                    peer,
                } => {
                    let terms = (link, version, reliable, sealed);
                    self.linked(interface, terms, peer, &mut came, epoll);
                }
                Output::Unlink {
                    interface,
                    link,
                    code,
                } => {
                    self.with(interface, epoll, |interface, tools| {
                        interface.unlink(link, code, tools);
                    });
                    self.sleepers.wake(Topic::Interface(interface));
                }
                Output::Withdrawn { .. } => {}
                Output::Page {
                    revision,
                    items,
                    next,
                } => {
                    self.session.answer(Page {
                        revision,
                        items,
                        next,
                    });
                    self.sleepers.wake(Topic::Session);
                }
                //= SM2-NOD-003
                // Links are left alone. Coming back to the next Manager starts here.
                Output::Ended(end) => {
                    self.session.hang_up(end, epoll);
                    self.interfaces
                        .values_mut()
                        .for_each(Interface::expect_no_links);
                    self.sleepers.wake(Topic::Session);
                }
            }
        }
    }

    fn greeted(&mut self, greeting: Greeting) {
        self.session.greeting = greeting;
        self.sleepers.wake(Topic::Session);
    }

    fn answered(&mut self, id: InterfaceId, state: State) {
        match self.interfaces.get_mut(&id) {
            Some(interface) => interface.state = state,
            // Whoever declared it has given up waiting. Refused already, if it is not live.
            None => self.session.tell(Input::Withdraw { interface: id }),
        }
        self.sleepers.wake(Topic::Interface(id));
    }

    /// A new link, whose socket came along.
    fn linked(
        &mut self,
        id: InterfaceId,
        (link, version, reliable, sealed): (LinkId, u16, bool, bool),
        peer: Peer,
        came: &mut Incoming,
        epoll: &Epoll,
    ) {
        let Some(interface) = self.interfaces.get_mut(&id) else {
            return;
        };
        interface.linked += 1;
        let token = self.last_token + 1;
        let socket = (came.take_fd())
            .ok_or_else(|| io::Error::from(io::ErrorKind::NotFound))
            .and_then(SeqPacket::from_fd)
            .and_then(|socket| {
                epoll.add(&socket, token, Interest::READABLE)?;
                Ok(socket)
            });
        match socket {
            Ok(socket) => {
                let config = Config::new(&interface.contract, link, version, reliable, sealed);
                let driver = LinkDriver::new(token, Arc::new(peer), socket, config);
                self.last_token = token;
                self.routes.insert(token, id);
                self.with(id, epoll, |interface, tools| {
                    interface.add_link(token, driver, tools);
                });
            }
            Err(error) => {
                tracing::warn!(%link, peer = %peer.name, %error, "cannot use the link's socket");
                let code = Farewell::Resources.code();
                self.session.unlinked(id, link, code);
            }
        }
        self.sleepers.wake(Topic::Interface(id));
    }

    // ---- what handles ask for ----

    pub(crate) const fn greeting(&self) -> &Greeting {
        &self.session.greeting
    }

    /// Why there is no Manager, if there is none.
    pub(crate) fn session_end(&self) -> Option<End> {
        self.session.end()
    }

    /// Sends DECLARE.
    pub(crate) fn declare(
        &mut self,
        contract: Contract,
        pool_limit_bytes: u64,
        epoll: &Epoll,
    ) -> Result<InterfaceId, node::Error> {
        let id = self.session.declare(contract.clone())?;
        let interface = Interface::new(contract, pool_limit_bytes);
        self.interfaces.insert(id, interface);
        self.drain_session(Incoming::default(), epoll);
        Ok(id)
    }

    /// Ends an interface: its links with CLOSE, and then with the Manager.
    pub(crate) fn withdraw(&mut self, id: InterfaceId, epoll: &Epoll) {
        self.with(id, epoll, |interface, tools| interface.close(tools));
        if let Some(interface) = self.interfaces.remove(&id) {
            for token in interface.tokens() {
                self.routes.remove(&token);
            }
        }
        self.session.tell(Input::Withdraw { interface: id });
        self.drain_session(Incoming::default(), epoll);
        self.sleepers.wake(Topic::Session);
    }

    /// Asks for a page; the answer is [taken](Self::take_page) later.
    pub(crate) fn query(&mut self, after: Option<sm2_proto::control::Cursor>, epoll: &Epoll) {
        self.session.query(after);
        self.drain_session(Incoming::default(), epoll);
    }

    pub(crate) const fn take_page(&mut self) -> Option<Page> {
        self.session.take_page()
    }
}
