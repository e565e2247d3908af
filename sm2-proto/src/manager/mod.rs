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
//! Each operation costs O(log n) in the size of the domain, plus the
//! counterparts on the topic or service that it touches.

mod broker;
mod channel;
mod event;
#[cfg(feature = "fuzzing")]
pub(crate) mod fuzz;
mod links;
mod page;
mod phase;
mod policy;
mod session;

use alloc::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    vec::Vec,
};

use self::{
    channel::Channels,
    links::{End, Links},
    policy::Users,
    session::Session,
};
pub use self::{
    event::{Cause, Credentials, Input, Misuse, Output},
    phase::{PHASES, Phase, REQUESTS, Request, legal},
    policy::Policy,
};
use crate::{
    Datagram, Farewell, Instant, Name, NodeId, Refusal, VERSION, Violation,
    control::{ToManager, ToNode, decode_to_manager, encode_to_node},
};

/// The machine. See the [module](self) for the order of calls.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Manager {
    policy: Policy,
    revision: u64,
    last_session: u64,
    sessions: BTreeMap<NodeId, Session>,
    names: BTreeSet<Name>,
    users: Users,
    channels: Channels,
    links: Links,
    /// By when each session that is not ready has to be. They came in the order
    /// of their numbers, so the first one's deadline is the earliest.
    greeting: BTreeMap<NodeId, Instant>,
    outputs: VecDeque<Output>,
}

impl Manager {
    /// A Manager without sessions. `epoch` is a number that no other Manager
    /// of this domain has used (SM2-SES-007): a random one will do.
    //= SM2-SES-007
    #[must_use]
    pub const fn new(epoch: u64, policy: Policy) -> Self {
        Self {
            policy,
            revision: 0,
            last_session: 0,
            sessions: BTreeMap::new(),
            names: BTreeSet::new(),
            users: Users::new(),
            channels: Channels::new(),
            links: Links::new(epoch),
            greeting: BTreeMap::new(),
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
        self.links.len()
    }

    /// When [`Input::Tick`] is due.
    #[must_use]
    pub fn deadline(&self) -> Option<Instant> {
        let (_, &deadline) = self.greeting.first_key_value()?;
        Some(deadline)
    }

    /// The next thing to do.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// Takes one input. Sessions that are over, or were never told of, are
    /// ignored: their datagrams may still have been on the way.
    pub fn handle(&mut self, now: Instant, input: Input<'_>) -> Result<(), Misuse> {
        debug_assert!(
            self.outputs.is_empty() || matches!(input, Input::LinkFailed { .. }),
            "the outputs of the input before have to be polled first"
        );
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

    //= SM2-SES-007
    fn connect(&mut self, now: Instant, id: NodeId, who: Credentials) -> Result<(), Misuse> {
        if id.0 <= self.last_session {
            return Err(Misuse::SessionNumber(id));
        }
        self.last_session = id.0;
        self.sessions.insert(id, Session::new(who));
        self.greeting.insert(id, now.after(self.policy.greeting));
        if !self.users.connect(who.uid, &self.policy) {
            self.end_session(id, Cause::Farewell(Farewell::Resources));
        }
        Ok(())
    }

    //= SM2-SES-004
    fn expire_greetings(&mut self, now: Instant) {
        while let Some(first) = self.greeting.first_entry()
            && *first.get() <= now
        {
            let (id, _) = first.remove_entry();
            self.end_session(id, Cause::Farewell(Farewell::GreetingTimeout));
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
    fn step(&mut self, node: NodeId, phase: Phase, frame: ToManager) -> Result<(), Violation> {
        legal(phase, Request::of(&frame))?;
        match frame {
            ToManager::Hello {
                min_version,
                max_version,
                name,
            } => self.hello(node, min_version, max_version, name),
            ToManager::Declare {
                interface,
                contract,
            } => self.declare(End { node, interface }, contract),
            ToManager::Withdraw { interface } => self.withdraw(End { node, interface }),
            ToManager::Unlinked {
                interface,
                link,
                code,
            } => self.unlinked(End { node, interface }, link, code),
            ToManager::Query { after } => {
                self.answer_query(node, after);
                Ok(())
            }
            ToManager::Goodbye { code } => {
                self.end_session(node, Cause::Goodbye(code));
                Ok(())
            }
        }
    }

    //= SM2-SES-002, SM2-SES-003, SM2-VER-001
    fn hello(&mut self, id: NodeId, min: u16, max: u16, name: Name) -> Result<(), Violation> {
        if min == 0 || min > max {
            return Err(Violation::BadVersionRange);
        }
        let Some(session) = self.sessions.get_mut(&id) else {
            return Ok(());
        };
        let uid = session.credentials().uid;
        let versions = min..=max;
        let granted = if !versions.contains(&VERSION) {
            Err(Refusal::Version {
                min: VERSION,
                max: VERSION,
            })
        } else if self.names.contains(&name) {
            Err(Refusal::NameTaken)
        } else {
            self.users.refuse_session(uid, &self.policy)
        };
        let answer = match granted {
            Err(reason) => ToNode::HelloRefused { reason },
            Ok(()) => {
                session.welcome(name.clone());
                self.greeting.remove(&id);
                self.users.greet(uid);
                self.names.insert(name);
                self.revision += 1;
                ToNode::Welcome {
                    version: VERSION,
                    epoch: self.links.epoch(),
                    node: id,
                }
            }
        };
        self.send(id, &answer);
        Ok(())
    }

    //= SM2-SES-005, SM2-SES-006
    fn end_session(&mut self, id: NodeId, cause: Cause) {
        let Some(session) = self.sessions.remove(&id) else {
            return;
        };
        let uid = session.credentials().uid;
        self.greeting.remove(&id);
        if let Some(name) = session.name() {
            self.names.remove(name);
            self.revision += 1;
        }
        self.users
            .leave(uid, session.is_ready(), session.interfaces());
        for (interface, contract, links) in session.into_interfaces() {
            let node = id;
            let end = End { node, interface };
            self.channels.remove(end, &contract);
            for link in links {
                self.end_link(link, end, Farewell::PeerGone.code());
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

    /// Every session is over. Nobody is told of the links: they live on.
    //= SM2-SES-008
    fn shut_down(&mut self) {
        self.links.clear();
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
        let sessions = || self.sessions.values();
        let rules = [
            (
                sessions().filter(|it| it.is_ready()).count() == self.names.len(),
                "each ready session has one name, and each name one",
            ),
            (
                sessions().filter(|it| !it.is_ready()).count() == self.greeting.len(),
                "each session that is not ready has a deadline",
            ),
            (
                sessions().map(Session::interfaces).sum::<usize>() == self.channels.ends(),
                "each interface stands in one channel",
            ),
            (
                self.channels.are_tight(),
                "each channel has interfaces, and a type as long as one states it",
            ),
            (
                sessions().map(Session::live_ends).sum::<usize>() == 2 * self.links.len(),
                "each live link has two live ends",
            ),
            (
                sessions().all(Session::counts_its_ends),
                "each session knows how many ends of links it has",
            ),
            (
                self.users.are(sessions()),
                "charges per user equal a recount",
            ),
        ];
        let broken = rules.iter().find(|(holds, _)| !holds);
        broken.map_or(Ok(()), |&(_, rule)| Err(rule))
    }
}
