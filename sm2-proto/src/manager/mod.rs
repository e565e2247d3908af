//! The Manager: who is in the domain and who is linked with whom (SPEC sections 4, 5).
//!
//! | to do | call |
//! | --- | --- |
//! | feed | [`Manager::handle`] |
//! | drain | [`Manager::poll`] until it gives nothing, after every feed |
//! | deadline | [`Manager::deadline`]: then feed [`Input::Tick`] |
//! | inspect | [`Manager::revision`], [`Manager::sessions`], [`Manager::links`] |
//!
//! One machine serves all sessions. The driver numbers the connections that it
//! accepts, makes the socket pairs that [`Output::Link`] asks for, and closes
//! the connections that [`Output::HangUp`] names. A violation ends the session
//! of whoever committed it and nothing else.
//!
//! Each operation costs O(log n) in the size of the domain, plus the links
//! that it makes or ends.

mod channel;
mod links;
mod page;
mod phase;
mod policy;
mod session;

use alloc::{
    collections::{BTreeMap, VecDeque},
    vec::Vec,
};

use self::{
    channel::Channels,
    links::{End, Links},
    phase::{Phase, Request},
    policy::Users,
    session::Session,
};
pub use self::{
    phase::{PHASES, REQUESTS, legal},
    policy::Policy,
};
use crate::{
    Code, Contract, Datagram, Farewell, Instant, InterfaceId, LinkId, Name, NodeId, Quota, Refusal,
    VERSION, Violation,
    control::{Peer, ToManager, ToNode, decode_to_manager, encode_to_node},
};

/// Who is at the other end of a connection, as the kernel says.
//= SM2-TRN-007
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Credentials {
    /// User.
    pub uid: u32,
    /// Group.
    pub gid: u32,
    /// Process.
    pub pid: i32,
}

/// What happens to a Manager.
#[derive(Clone, Debug)]
pub enum Input<'a> {
    /// A connection was accepted.
    Connected {
        /// The driver's number for it: greater than all before, not zero.
        session: NodeId,
        /// Whose it is.
        credentials: Credentials,
    },
    /// A node sent a datagram.
    Datagram {
        /// Which node.
        session: NodeId,
        /// What it sent.
        datagram: Datagram<'a>,
    },
    /// A node's end of the connection is gone.
    Closed {
        /// Which node.
        session: NodeId,
    },
    /// A node does not read, or does not take descriptors: give it up.
    Stalled {
        /// Which node.
        session: NodeId,
    },
    /// There was no socket pair for a link: its two ends know nothing of it.
    LinkFailed {
        /// Which link.
        link: LinkId,
    },
    /// The deadline has come.
    Tick,
    /// Say goodbye to everybody.
    Shutdown,
}

/// What the driver has to do.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Send a frame.
    Send {
        /// To whom.
        session: NodeId,
        /// The datagram.
        frame: Vec<u8>,
    },
    /// Make a socket pair and send one end with each of the two frames. If
    /// there is none to be had, feed [`Input::LinkFailed`] and send neither.
    Link {
        /// Which link.
        link: LinkId,
        /// To whom, and what.
        ends: [(NodeId, Vec<u8>); 2],
    },
    /// Send the goodbye, if any, as far as the socket takes it, and close the
    /// connection. The machine does not know the session any more.
    HangUp {
        /// Whose.
        session: NodeId,
        /// The datagram to send.
        goodbye: Option<Vec<u8>>,
        /// Why.
        cause: Cause,
    },
}

/// Why a session is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Cause {
    /// The node broke SPEC.
    Violation(Violation),
    /// Its end of the connection is gone.
    Gone,
    /// It said goodbye.
    Goodbye(Code),
    /// The Manager gave it up.
    Farewell(Farewell),
}

/// What a driver did wrong. Nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Misuse {
    /// Numbers of connections must grow.
    #[error("session numbers must grow: {0} was used before")]
    SessionNumber(NodeId),
}

/// The machine. See the [module](self) for the order of calls.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Manager {
    epoch: u64,
    policy: Policy,
    revision: u64,
    last_session: u64,
    sessions: BTreeMap<NodeId, Session>,
    names: BTreeMap<Name, NodeId>,
    users: Users,
    channels: Channels,
    links: Links,
    /// Who still has to greet, by deadline; may name sessions that did or left.
    greeting: VecDeque<(Instant, NodeId)>,
    outputs: VecDeque<Output>,
}

impl Manager {
    /// A Manager without sessions. `epoch` is a number that no other Manager
    /// of this domain has used (SM2-SES-007): a random one will do.
    //= SM2-SES-007
    #[must_use]
    pub const fn new(epoch: u64, policy: Policy) -> Self {
        Self {
            epoch,
            policy,
            revision: 0,
            last_session: 0,
            sessions: BTreeMap::new(),
            names: BTreeMap::new(),
            users: Users::new(),
            channels: Channels::new(),
            links: Links::new(),
            greeting: VecDeque::new(),
            outputs: VecDeque::new(),
        }
    }

    /// A number that changes whenever a page would show something else.
    #[must_use]
    pub const fn revision(&self) -> u64 {
        self.revision
    }

    /// How many connections there are, ready or not.
    #[must_use]
    pub fn sessions(&self) -> usize {
        self.sessions.len()
    }

    /// How many links are live at both ends.
    #[must_use]
    pub fn links(&self) -> usize {
        self.links.live()
    }

    /// When [`Input::Tick`] is due.
    #[must_use]
    pub fn deadline(&self) -> Option<Instant> {
        self.greeting.front().map(|&(deadline, _)| deadline)
    }

    /// The next thing to do.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// Takes one input. Sessions that are over, or were never told of, are
    /// ignored: their datagrams may still have been on the way.
    pub fn handle(&mut self, now: Instant, input: Input<'_>) -> Result<(), Misuse> {
        self.expire_greetings(now);
        match input {
            Input::Connected {
                session,
                credentials,
            } => self.connect(now, session, credentials)?,
            Input::Datagram { session, datagram } => self.receive(session, &datagram),
            Input::Closed { session } => self.end_session(session, Cause::Gone),
            Input::Stalled { session } => {
                self.end_session(session, Cause::Farewell(Farewell::Stalled));
            }
            Input::LinkFailed { link } => self.link_failed(link),
            Input::Tick => {}
            Input::Shutdown => self.shut_down(),
        }
        debug_assert_eq!(self.invariants(), Ok(()));
        Ok(())
    }

    fn connect(&mut self, now: Instant, id: NodeId, who: Credentials) -> Result<(), Misuse> {
        if id.0 <= self.last_session {
            return Err(Misuse::SessionNumber(id));
        }
        self.last_session = id.0;
        self.sessions.insert(id, Session::new(who));
        if self.users.connect(who.uid, &self.policy) {
            self.greeting
                .push_back((now.after(self.policy.greeting), id));
        } else {
            self.end_session(id, Cause::Farewell(Farewell::Resources));
        }
        Ok(())
    }

    //= SM2-SES-004
    fn expire_greetings(&mut self, now: Instant) {
        while let Some(&(deadline, id)) = self.greeting.front() {
            let greeting = self
                .sessions
                .get(&id)
                .is_some_and(|session| !session.is_ready());
            if greeting && deadline > now {
                return;
            }
            self.greeting.pop_front();
            if greeting {
                self.end_session(id, Cause::Farewell(Farewell::GreetingTimeout));
            }
        }
    }

    fn receive(&mut self, id: NodeId, datagram: &Datagram<'_>) {
        let Some(session) = self.sessions.get(&id) else {
            return;
        };
        let phase = session.phase();
        let step = decode_to_manager(datagram).and_then(|frame| self.step(id, phase, frame));
        if let Err(violation) = step {
            self.end_session(id, Cause::Violation(violation));
        }
    }

    /// One frame of one session: the table of SPEC section 4.1.
    fn step(&mut self, id: NodeId, phase: Phase, frame: ToManager) -> Result<(), Violation> {
        legal(phase, Request::of(&frame))?;
        match frame {
            ToManager::Hello {
                min_version,
                max_version,
                name,
            } => self.hello(id, min_version, max_version, name),
            ToManager::Declare {
                interface,
                contract,
            } => self.declare(id, interface, contract),
            ToManager::Withdraw { interface } => self.withdraw(id, interface),
            ToManager::Unlinked {
                interface,
                link,
                code,
            } => self.unlinked(
                End {
                    node: id,
                    interface,
                },
                link,
                code,
            ),
            ToManager::Query { after } => {
                self.answer_query(id, after);
                Ok(())
            }
            ToManager::Goodbye { code } => {
                self.end_session(id, Cause::Goodbye(code));
                Ok(())
            }
        }
    }

    //= SM2-SES-002, SM2-SES-003, SM2-VER-001
    fn hello(&mut self, id: NodeId, min: u16, max: u16, name: Name) -> Result<(), Violation> {
        if min == 0 || min > max {
            return Err(Violation::BadVersionRange);
        }
        if let Some(reason) = self.refuse_hello(id, min, max, &name) {
            self.send(id, &ToNode::HelloRefused { reason });
            return Ok(());
        }
        let Some(session) = self.sessions.get_mut(&id) else {
            return Ok(());
        };
        session.welcome(name.clone());
        self.users.greet(session.credentials().uid);
        self.names.insert(name, id);
        self.revision += 1;
        self.send(
            id,
            &ToNode::Welcome {
                version: VERSION,
                epoch: self.epoch,
                node: id,
            },
        );
        Ok(())
    }

    fn refuse_hello(&self, id: NodeId, min: u16, max: u16, name: &Name) -> Option<Refusal> {
        if !(min..=max).contains(&VERSION) {
            return Some(Refusal::Version {
                min: VERSION,
                max: VERSION,
            });
        }
        if self.names.contains_key(name) {
            return Some(Refusal::NameTaken);
        }
        let uid = self.sessions.get(&id)?.credentials().uid;
        self.users.refuse_session(uid, &self.policy)
    }

    fn declare(
        &mut self,
        id: NodeId,
        interface: InterfaceId,
        contract: Contract,
    ) -> Result<(), Violation> {
        let end = End {
            node: id,
            interface,
        };
        let Some(session) = self.sessions.get_mut(&id) else {
            return Ok(());
        };
        session.number(interface)?;
        match self.admit(id, &contract) {
            Ok(matches) => self.admitted(end, contract, &matches),
            Err(reason) => self.send(id, &ToNode::DeclareRefused { interface, reason }),
        }
        Ok(())
    }

    /// Whether an interface can be granted, and whom it is to be linked with.
    //= SM2-IFC-005, SM2-IFC-006, SM2-MAT-002
    fn admit(&self, id: NodeId, contract: &Contract) -> Result<Vec<End>, Refusal> {
        let Some(session) = self.sessions.get(&id) else {
            return Ok(Vec::new());
        };
        session.refuse_interface(&self.policy)?;
        self.users
            .refuse_interface(session.credentials().uid, &self.policy)?;
        self.channels.refuse_types(contract)?;
        let links = |node: NodeId| self.sessions.get(&node).map_or(0, Session::link_ends);
        let limit = self.policy.links_per_session;
        let mut matches = self.channels.matches(contract);
        matches.retain(|end| end.node == id || links(end.node) < limit);
        // A link within one session has both of its ends there.
        let ends: usize = matches
            .iter()
            .map(|end| if end.node == id { 2 } else { 1 })
            .sum();
        if links(id) + ends > limit {
            let limit = u32::try_from(limit).unwrap_or(u32::MAX);
            return Err(Refusal::Quota {
                quota: Quota::LinksPerSession,
                limit,
            });
        }
        Ok(matches)
    }

    //= SM2-IFC-002
    fn admitted(&mut self, end: End, contract: Contract, matches: &[End]) {
        let Some(session) = self.sessions.get_mut(&end.node) else {
            return;
        };
        self.users.declare(session.credentials().uid);
        self.channels.insert(end, &contract);
        session.declare(end.interface, contract);
        self.revision += 1;
        let count = u32::try_from(matches.len()).unwrap_or(u32::MAX);
        self.send(
            end.node,
            &ToNode::Declared {
                interface: end.interface,
                matches: count,
            },
        );
        for &other in matches {
            self.link(end, other);
        }
    }

    //= SM2-LNK-001, SM2-LNK-002, SM2-MAT-002, SM2-MAT-003, SM2-VER-002
    fn link(&mut self, one: End, other: End) {
        let (Some(ours), Some(theirs)) = (self.peer(one), self.peer(other)) else {
            return;
        };
        let Ok(terms) = crate::match_contracts(&ours.contract, &theirs.contract) else {
            return;
        };
        let uid = |end: End| self.sessions.get(&end.node).map(|s| s.credentials().uid);
        let sealed = terms.sealed || self.policy.seals(uid(one) == uid(other));
        let link = LinkId {
            epoch: self.epoch,
            serial: self.links.insert(one, other),
        };
        for end in [one, other] {
            if let Some(session) = self.sessions.get_mut(&end.node) {
                session.link(end.interface, link.serial);
            }
        }
        self.revision += 1;
        let frame = |interface: InterfaceId, peer: Peer| {
            let (version, reliable) = (VERSION, terms.reliable);
            encode_to_node(&ToNode::Link {
                interface,
                link,
                version,
                reliable,
                sealed,
                peer,
            })
        };
        let ends = [
            (one.node, frame(one.interface, theirs)),
            (other.node, frame(other.interface, ours)),
        ];
        self.outputs.push_back(Output::Link { link, ends });
    }

    fn peer(&self, end: End) -> Option<Peer> {
        let session = self.sessions.get(&end.node)?;
        Some(Peer {
            node: end.node,
            name: session.name()?.clone(),
            interface: end.interface,
            contract: session.contract(end.interface)?.clone(),
        })
    }

    fn link_failed(&mut self, link: LinkId) {
        if link.epoch != self.epoch {
            return;
        }
        for end in self.links.remove(link.serial) {
            self.forget_link(end, link.serial);
        }
        self.revision += 1;
    }

    //= SM2-IFC-003
    fn withdraw(&mut self, id: NodeId, interface: InterfaceId) -> Result<(), Violation> {
        let end = End {
            node: id,
            interface,
        };
        let session = self
            .sessions
            .get_mut(&id)
            .ok_or(Violation::UnknownInterface)?;
        let (contract, links) = session
            .withdraw(interface)
            .ok_or(Violation::UnknownInterface)?;
        let uid = session.credentials().uid;
        self.users.withdraw(uid, 1);
        self.channels.remove(end, &contract);
        for serial in links {
            self.leave_link(end, serial, Farewell::Done.code());
        }
        self.revision += 1;
        self.send(id, &ToNode::Withdrawn { interface });
        Ok(())
    }

    /// A node's farewell to its end of a link.
    //= SM2-LNK-003, SM2-LNK-004
    fn unlinked(&mut self, end: End, link: LinkId, code: Code) -> Result<(), Violation> {
        let session = self
            .sessions
            .get(&end.node)
            .ok_or(Violation::UnknownInterface)?;
        let known = session.knows_link(end.interface, link.serial)?;
        if link.epoch != self.epoch || !known {
            return Err(Violation::UnknownLink);
        }
        self.forget_link(end, link.serial);
        if self.links.farewell(link.serial, end) {
            // The node was first: it gets its answer, and the other side is told.
            self.send(
                end.node,
                &ToNode::Unlink {
                    interface: end.interface,
                    link,
                    code,
                },
            );
            self.tell_other(end, link.serial, code);
            self.revision += 1;
        }
        Ok(())
    }

    /// An end of a link is gone without a word to its own side: its interface is.
    fn leave_link(&mut self, end: End, serial: u64, code: Code) {
        if self.links.farewell(serial, end) {
            self.tell_other(end, serial, code);
        }
    }

    fn tell_other(&mut self, end: End, serial: u64, code: Code) {
        if let Some(other) = self.links.tell_other(serial, end) {
            let link = LinkId {
                epoch: self.epoch,
                serial,
            };
            let interface = other.interface;
            self.send(
                other.node,
                &ToNode::Unlink {
                    interface,
                    link,
                    code,
                },
            );
        }
    }

    fn forget_link(&mut self, end: End, serial: u64) {
        if let Some(session) = self.sessions.get_mut(&end.node) {
            session.forget_link(end.interface, serial);
        }
    }

    //= SM2-SES-005, SM2-SES-006
    fn end_session(&mut self, id: NodeId, cause: Cause) {
        let Some(session) = self.sessions.remove(&id) else {
            return;
        };
        let uid = session.credentials().uid;
        if let Some(name) = session.name() {
            self.names.remove(name);
            self.revision += 1;
        }
        self.users.leave(uid, session.is_ready());
        let interfaces = session.into_interfaces();
        self.users.withdraw(uid, interfaces.len());
        for (interface, contract, links) in interfaces {
            let end = End {
                node: id,
                interface,
            };
            self.channels.remove(end, &contract);
            for serial in links {
                self.leave_link(end, serial, Farewell::PeerGone.code());
            }
        }
        let goodbye = cause
            .code()
            .map(|code| encode_to_node(&ToNode::Goodbye { code }));
        self.outputs.push_back(Output::HangUp {
            session: id,
            goodbye,
            cause,
        });
    }

    fn shut_down(&mut self) {
        let sessions: Vec<NodeId> = self.sessions.keys().copied().collect();
        for id in sessions {
            self.end_session(id, Cause::Farewell(Farewell::ShuttingDown));
        }
    }

    fn send(&mut self, session: NodeId, frame: &ToNode) {
        if self.sessions.contains_key(&session) {
            self.outputs.push_back(Output::Send {
                session,
                frame: encode_to_node(frame),
            });
        }
    }

    /// What must hold between the tables; the first that does not.
    fn invariants(&self) -> Result<(), &'static str> {
        let ready = self
            .sessions
            .values()
            .filter(|session| session.is_ready())
            .count();
        if ready != self.names.len() {
            return Err("each ready session has one name, and each name one");
        }
        if self
            .sessions
            .values()
            .map(Session::interfaces)
            .sum::<usize>()
            != self.channels.ends()
        {
            return Err("each interface stands in one channel");
        }
        if self
            .sessions
            .values()
            .map(Session::link_ends)
            .sum::<usize>()
            != self.links.ends()
        {
            return Err("sessions and links know the same ends");
        }
        self.users.check(self.sessions.values())
    }
}

impl Cause {
    /// The code to say goodbye with; none if nobody is there to hear it.
    const fn code(self) -> Option<Code> {
        match self {
            Self::Violation(violation) => Some(violation.code()),
            Self::Farewell(farewell) => Some(farewell.code()),
            Self::Gone | Self::Goodbye(_) => None,
        }
    }
}
