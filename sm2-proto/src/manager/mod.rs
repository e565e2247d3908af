//! The Manager: the nodes of a domain, their interfaces and their links (SPEC sections 4 and 5).
//!
//! | to do | call |
//! | --- | --- |
//! | feed, drain, deadline | [`Machine`]; at the deadline, feed [`Input::Tick`] |
//! | inspect | [`Manager::revision`], [`Manager::sessions`], [`Manager::links`] |
//! | ask before reading and writing | [`Manager::is_busy`], [`Manager::awaits_room`] |
//!
//! One machine serves all sessions. The driver numbers the connections that it accepts, makes the socket pairs that
//! [`Output::Link`] asks for, and closes the connections that [`Output::HangUp`] names. A violation ends the session of
//! the node that committed it, and nothing else.
//!
//! Each input does a bounded amount of work ([`Limit::WorkPerTurn`]). Longer work is done in parts: the deadline is
//! then in the past, each [`Input::Tick`] does one part, and the further frames of the session wait in its socket
//! ([`Manager::is_busy`]). LINKs wait for nodes that do not read their sockets ([`Manager::awaits_room`]).
//!
//! The example `own_loop` of `sm2-manager` is a complete driver in a loop of its own.

mod access;
mod adoption;
mod broker;
mod budget;
mod channel;
mod claims;
mod describe;
mod ending_links;
mod endings;
mod event;
mod fair_queue;
mod flow_control;
#[cfg(feature = "fuzzing")]
pub(crate) mod fuzz;
mod inspect;
mod invariants;
mod links;
mod log;
mod new_policy;
mod node_record;
mod page;
mod pending_links;
mod phase;
#[cfg(any(kani, test))]
mod proofs;
mod quota;
mod reload;
mod reload_requests;
mod requested_reload;
mod round_robin;
mod schemas;
mod session;
mod shortage;
mod sight;
mod unlinked;
mod users;
mod watch;
mod work;

use alloc::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    vec::Vec,
};
use core::convert::Infallible;

use self::{
    access::Access,
    budget::Budget,
    channel::Channels,
    claims::{Claim, Claims},
    ending_links::EndingLinks,
    fair_queue::FairQueue,
    links::{Agreed, Links},
    log::Log,
    node_record::NodeRecord,
    pending_links::PendingLinks,
    reload::Reload,
    reload_requests::ReloadRequests,
    schemas::Schemas,
    session::Session,
    shortage::Shortage,
    unlinked::UnlinkedPairs,
    users::Users,
};
pub use self::{
    event::{Cause, Credentials, Input, Misuse, Output},
    phase::{PHASES, Phase, TO_MANAGER_KINDS, ToManagerKind, legal},
    session::STANDBY_PREFIX,
};
use crate::{
    Datagram, EntityId, Farewell, FdFacts, Instant, LinkQos, Machine, MisuseError, Name, NodeId,
    Refusal, VERSION, Violation,
    control::{
        Key, Limit, Limits, SchemaText, ToManager, ToNode, decode_to_manager, encode_to_node,
    },
    machine::debug_assert_drained,
};

/// The machine. See the [module](self) for the order of calls.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Manager {
    limits: Limits,
    log: Log,
    last_node: NodeId,
    access: Access,
    sessions: BTreeMap<NodeId, Session>,
    names: BTreeSet<Name>,
    users: Users,
    channels: Channels,
    links: Links,
    claims: Claims,
    unlinked_pairs: UnlinkedPairs,
    schemas: Schemas,
    /// The sessions that wait for a change of the domain.
    watchers: BTreeSet<NodeId>,
    /// The latest time for each session that is not ready to be so. Sessions are numbered as they came, so the first
    /// deadline is the earliest.
    greeting: BTreeMap<NodeId, Instant>,
    pending_links: PendingLinks,
    /// The sessions whose claims have waited long enough and are being given up.
    expired: BTreeSet<NodeId>,
    ending_links: EndingLinks,
    /// The sessions that are busy. Some of them are over.
    jobs: FairQueue,
    shortage: Shortage,
    /// The sessions whose counters were lost, and when to ask for them again.
    lost_counters: VecDeque<(Instant, NodeId)>,
    reload: Reload,
    reload_requests: ReloadRequests,
    /// The time since which deferred work can be done.
    due: Option<Instant>,
    outputs: VecDeque<Output>,
}

impl Manager {
    /// A Manager without sessions. `epoch` is a number that no other Manager of this domain has
    /// used (SM2-SES-007); a random number will do. `secret` is a random number that no other
    /// process knows: the keys of links follow from it (SM2-LNK-002).
    //= SM2-SES-007
    #[must_use]
    pub const fn new(epoch: u64, secret: u128, limits: Limits) -> Self {
        Self {
            limits,
            log: Log::new(limits.count(Limit::ChangesRemembered)),
            last_node: NodeId(0),
            access: Access::new(),
            sessions: BTreeMap::new(),
            names: BTreeSet::new(),
            users: Users::new(),
            channels: Channels::new(),
            links: Links::new(epoch, secret),
            claims: Claims::new(),
            unlinked_pairs: UnlinkedPairs::new(),
            schemas: Schemas::new(),
            watchers: BTreeSet::new(),
            greeting: BTreeMap::new(),
            pending_links: PendingLinks::new(),
            expired: BTreeSet::new(),
            ending_links: EndingLinks::new(),
            jobs: FairQueue::new(limits.count(Limit::WorkPerTurn)),
            shortage: Shortage::new(),
            lost_counters: VecDeque::new(),
            reload: Reload::new(),
            reload_requests: ReloadRequests::new(),
            due: None,
            outputs: VecDeque::new(),
        }
    }

    /// A number that changes whenever a page would show something else.
    #[must_use]
    pub const fn revision(&self) -> u64 {
        self.log.revision()
    }

    /// The number of connections, ready or not.
    #[must_use]
    pub fn sessions(&self) -> usize {
        self.sessions.len()
    }

    /// Whether the HELLO of a session was granted.
    #[must_use]
    pub fn is_welcomed(&self, node: NodeId) -> bool {
        self.sessions.get(&node).and_then(Session::node).is_some()
    }

    /// The number of links that are live at both ends.
    #[must_use]
    pub fn links(&self) -> usize {
        self.links.len()
    }
}

impl Machine for Manager {
    type Input<'a> = Input<'a>;
    type Output = Output;
    /// A violation ends the session that committed it, never the Manager.
    type End = Infallible;
    type Misuse = Misuse;

    /// Takes one input. Inputs for sessions that have ended are ignored: their datagrams may have
    /// been read before the end.
    fn handle(&mut self, now: Instant, input: Input<'_>) -> Result<(), MisuseError<Misuse>> {
        if !matches!(input, Input::LinkFailed { .. }) {
            debug_assert_drained(&self.outputs);
        }
        if let Input::Connected { session, .. } = input
            && session <= self.last_node
        {
            return Err(Misuse::SessionNumber(session).into());
        }
        let before = self.log.revision();
        self.expire_greetings(now);
        self.expire_claims(now);
        self.shortage.expire(now);
        self.ask_for_lost_counters(now);
        match input {
            Input::Connected {
                session,
                credentials,
            } => self.connect(now, session, credentials),
            Input::Groups { session, gids } if self.sessions.contains_key(&session) => {
                self.access.add_groups(session, gids);
            }
            Input::Groups { .. } => {}
            Input::Datagram { session, datagram } => self.receive(now, session, &datagram),
            Input::Closed { session } => self.end_session(session, Cause::Gone),
            Input::Stalled { session } => {
                self.end_session(session, Cause::Farewell(Farewell::Stalled));
            }
            Input::LinkFailed { link } => self.link_failed(now, link),
            Input::Drained { session } => self.drained(session),
            Input::SetAccessPolicy(policy) => self.set_access_policy(policy),
            Input::AccessPolicyUnusable { problem, text } => self.refuse_reloads(problem, text),
            Input::Tick => self.run_deferred(now),
            Input::DismissStandbys => self.dismiss_standbys(),
            Input::Shutdown => self.shut_down(),
        }
        self.answer_reloads();
        self.wake_watchers(before);
        self.due = self.has_deferred(now).then_some(now);
        debug_assert_eq!(self.invariants(), Ok(()));
        Ok(())
    }

    fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// The time of the next [`Input::Tick`]. A time in the past means: at once, but after all other
    /// inputs that have come, because a tick does only a part of the work.
    fn deadline(&self) -> Option<Instant> {
        let greeting = self.greeting.first_key_value().map(|(_, &it)| it);
        let retry = self.shortage.deadline();
        let counters = self.lost_counters.front().map(|&(at, _)| at);
        let confirmation = self.reload.deadline();
        let all = [
            greeting,
            self.claims.deadline(),
            retry,
            counters,
            confirmation,
            self.due,
        ];
        all.into_iter().flatten().min()
    }
}

impl Manager {
    //= SM2-SES-007
    fn connect(&mut self, now: Instant, node: NodeId, who: Credentials) {
        self.last_node = node;
        self.sessions.insert(node, Session::new(who));
        self.greeting
            .insert(node, now.after(self.limits.time(Limit::Greeting)));
        if !self.users.connect(who, &self.limits) {
            self.end_session(node, Cause::Farewell(Farewell::Resources));
        }
    }

    //= SM2-SES-004
    fn expire_greetings(&mut self, now: Instant) {
        while let Some(first) = self.greeting.first_entry()
            && *first.get() <= now
        {
            let (node, _) = first.remove_entry();
            self.end_session(node, Cause::Farewell(Farewell::GreetingTimeout));
        }
    }

    fn receive(&mut self, now: Instant, node: NodeId, datagram: &Datagram<'_>) {
        if !self.sessions.contains_key(&node) {
            return;
        }
        self.finish(node);
        let Some(session) = self.sessions.get(&node) else {
            return;
        };
        let phase = session.phase();
        // `None` for COUNTERS: this process had no free descriptor for the file.
        let file = datagram.fds.first();
        let step = decode_to_manager(datagram)
            .and_then(|frame| legal(phase, ToManagerKind::of(&frame)).map(|()| frame))
            .and_then(|frame| self.step(now, node, frame, file));
        if let Err(violation) = step {
            self.end_session(node, Cause::Violation(violation));
        }
    }

    /// Handles one frame that is legal in the session's phase, and the descriptor that came with it.
    fn step(
        &mut self,
        now: Instant,
        node: NodeId,
        frame: ToManager,
        file: Option<&FdFacts>,
    ) -> Result<(), Violation> {
        let at = |interface| EntityId { node, interface };
        match frame {
            ToManager::Hello {
                min_version,
                max_version,
                name,
                resuming,
            } => self.hello(node, [min_version, max_version], name, resuming)?,
            ToManager::Declare {
                interface,
                contract,
            } => self.declare(at(interface), contract)?,
            ToManager::Withdraw { interface } => self.withdraw(at(interface))?,
            ToManager::Unlinked {
                interface,
                link,
                code,
            } => self.unlinked(now, at(interface), link, code)?,
            ToManager::Query { after } => self.answer_query(node, after),
            ToManager::Goodbye { code } => self.end_session(node, Cause::Goodbye(code)),
            ToManager::Claim {
                interface,
                link,
                key,
                version,
                reliable,
                sealed,
            } => {
                let qos = LinkQos { reliable, sealed };
                let agreed = Agreed { version, qos };
                self.claim(at(interface), link, Claim { key, agreed })?;
            }
            ToManager::Claimed => self.claimed(now, node),
            ToManager::Watch { after } => self.watch(node, after)?,
            ToManager::Counters => self.keep_counters(now, node, file)?,
            ToManager::Inspect { node: of } => self.inspect(node, of),
            ToManager::Schema(SchemaText { data, text }) => self.register(node, data, text)?,
            ToManager::Describe { data } => self.describe(node, data),
            ToManager::MaxLinks { max_links } => self.set_max_links(node, max_links),
            ToManager::Reload => self.reload(node)?,
            ToManager::Suspended { interface } => self.reload.suspended(at(interface))?,
        }
        Ok(())
    }

    //= SM2-SES-002, SM2-SES-003, SM2-VER-001
    fn hello(
        &mut self,
        node: NodeId,
        [min, max]: [u16; 2],
        name: Name,
        resuming: bool,
    ) -> Result<(), Violation> {
        if min == 0 || min > max {
            return Err(violation!(BadVersionRange, "SM2-SES-002"));
        }
        let Some(session) = self.sessions.get_mut(&node) else {
            return Ok(());
        };
        let who = session.credentials();
        let versions = min..=max;
        let granted = if !versions.contains(&VERSION) {
            Err(Refusal::Version {
                min: VERSION,
                max: VERSION,
            })
        } else if let Err(reason) = self.access.refuse_name(node, who, &name) {
            Err(reason)
        } else if self.names.contains(&name) {
            Err(Refusal::NameTaken)
        } else {
            self.users.refuse_session(who, &self.limits)
        };
        let answer = match granted {
            Err(reason) => ToNode::HelloRefused { reason },
            Ok(()) => {
                session.welcome(name.clone(), resuming)?;
                //= SM2-SES-004
                if !resuming {
                    self.greeting.remove(&node);
                }
                self.users.greet(who);
                self.access.welcome(node, who, &name);
                self.names.insert(name);
                self.node_changed(node);
                ToNode::Welcome {
                    version: VERSION,
                    epoch: self.links.epoch(),
                    node,
                }
            }
        };
        self.send(node, &answer);
        Ok(())
    }

    //= SM2-SES-005, SM2-SES-006
    fn end_session(&mut self, node: NodeId, cause: Cause) {
        let Some(session) = self.sessions.remove(&node) else {
            return;
        };
        self.greeting.remove(&node);
        if let Some(until) = session.claims_until() {
            self.claims.forget(until, node);
        }
        match session {
            Session::Greeting(credentials) => self.users.leave(credentials, false, 0),
            Session::Resuming { node: record, .. } | Session::Ready { node: record, .. } => {
                self.end_node(node, record);
            }
        }
        self.access.end(node);
        self.reload.forget_session(node);
        self.reload_requests.forget(node);
        self.pending_links.forget_session(node);
        self.expired.remove(&node);
        self.forget_lost_counters(node);
        self.work(node, &mut Budget::new(&self.limits));
        let goodbye = cause
            .code()
            .map(|code| encode_to_node(&ToNode::Goodbye { code }));
        self.outputs.push_back(Output::HangUp {
            session: node,
            goodbye,
            cause,
        });
    }

    /// Removes a welcomed node and all that it registered.
    fn end_node(&mut self, node: NodeId, mut record: NodeRecord) {
        self.names.remove(record.name());
        self.node_changed(node);
        self.users
            .leave(record.credentials(), true, record.interfaces());
        for data in record.schemas() {
            self.schemas.remove(data);
        }
        let entity = |interface| EntityId { node, interface };
        for interface in record.refused() {
            let entity = entity(interface);
            self.changed(Key::Member { entity });
        }
        for interface in record.interface_ids() {
            let entity = entity(interface);
            if let Some(remains) = record.withdraw(interface) {
                self.end_interface(entity, remains, Farewell::PeerGone);
            }
        }
    }

    /// Ends every session. Nodes hear nothing of their links, which live on.
    //= SM2-SES-008
    fn shut_down(&mut self) {
        for (link, pair) in self.links.iter().collect::<Vec<_>>() {
            self.pending_links.remove(pair, link);
            self.forget_link(link, pair);
        }
        let sessions: Vec<NodeId> = self.sessions.keys().copied().collect();
        for node in sessions {
            self.end_session(node, Cause::Farewell(Farewell::ShuttingDown));
        }
        self.finish_all();
    }

    /// Says goodbye to all standbys, which wait for the end of this Manager.
    //= SM2-RES-009
    fn dismiss_standbys(&mut self) {
        let sessions = self.sessions.iter();
        let standbys = sessions.filter(|(_, session)| session.is_standby());
        let standbys: Vec<NodeId> = standbys.map(|(&node, _)| node).collect();
        for node in standbys {
            self.end_session(node, Cause::Farewell(Farewell::ShuttingDown));
        }
    }

    fn send(&mut self, node: NodeId, frame: &ToNode) {
        if self.sessions.contains_key(&node) {
            self.outputs.push_back(Output::Send {
                session: node,
                frame: encode_to_node(frame),
            });
        }
    }
}
