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
//! The code has two layers. `registry` has the tables: what exists in the domain, what has changed, and who sees it.
//! The files beside it decide which interfaces and links there should be, and when frames are sent.
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
mod counter_files;
mod ending_links;
mod endings;
mod event;
mod fair_queue;
#[cfg(feature = "fuzzing")]
pub(crate) mod fuzz;
mod links;
mod log;
mod new_policy;
mod node_record;
mod outbox;
mod pending_links;
mod phase;
#[cfg(any(kani, test))]
mod proofs;
mod quota;
mod registry;
mod reload;
mod reload_requests;
mod round_robin;
mod schemas;
mod session;
mod sessions;
mod shortage;
mod unlinked;
mod users;
mod work;

use alloc::{collections::BTreeSet, sync::Arc, vec::Vec};
use core::convert::Infallible;

use self::{
    budget::Budget, claims::Claim, counter_files::CounterFiles, fair_queue::FairQueue,
    links::Agreed, node_record::NodeRecord, outbox::Outbox, registry::Registry, reload::Reload,
    reload_requests::ReloadRequests, schemas::Schemas, session::Session, sessions::broken,
    shortage::Shortage,
};
pub use self::{
    event::{Cause, Credentials, Input, Misuse, Output},
    phase::{PHASES, Phase, TO_MANAGER_KINDS, ToManagerKind, legal},
    session::STANDBY_PREFIX,
};
use crate::{
    Datagram, EntityId, Farewell, FdFacts, Instant, LinkQos, Machine, MisuseError, Name, NodeId,
    Refusal, VERSION, Violation,
    control::{Limit, Limits, ToManager, ToNode, decode_to_manager, encode_to_node},
    machine::debug_assert_drained,
    policy::AccessPolicy,
};

/// The machine. See the [module](self) for the order of calls.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Manager {
    limits: Limits,
    last_node: NodeId,
    registry: Registry,
    schemas: Schemas,
    /// The sessions whose claims have waited long enough and are being given up.
    expired: BTreeSet<NodeId>,
    /// The sessions that are busy. Some of them are over.
    jobs: FairQueue,
    shortage: Shortage,
    counter_files: CounterFiles,
    reload: Reload,
    reload_requests: ReloadRequests,
    /// The time since which deferred work can be done.
    due: Option<Instant>,
    outbox: Outbox,
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
            last_node: NodeId(0),
            registry: Registry::new(epoch, secret, limits),
            schemas: Schemas::new(),
            expired: BTreeSet::new(),
            jobs: FairQueue::new(limits.count(Limit::WorkPerTurn)),
            shortage: Shortage::new(),
            counter_files: CounterFiles::new(),
            reload: Reload::new(),
            reload_requests: ReloadRequests::new(),
            due: None,
            outbox: Outbox::new(),
        }
    }

    /// Sets the access policy of the domain. Without this call everything is allowed. To be called
    /// before the first input; later, [`Input::SetAccessPolicy`] sets another one.
    #[must_use]
    pub fn with_access_policy(mut self, policy: AccessPolicy) -> Self {
        self.registry.set_policy(Some(Arc::new(policy)));
        self
    }

    /// Whether a policy restricts the domain.
    #[must_use]
    pub const fn has_access_policy(&self) -> bool {
        self.registry.access().is_restricted()
    }

    /// Sets the user of the Manager's process. Its sessions and those of root may have the access
    /// policy read again. To be called before the first input; without it, only root may.
    //= SM2-ACC-017
    #[must_use]
    pub const fn with_owner(mut self, uid: u32) -> Self {
        self.reload_requests.owner = Some(uid);
        self
    }

    /// A number that changes whenever a page would show something else.
    #[must_use]
    pub const fn revision(&self) -> u64 {
        self.registry.revision()
    }

    /// The number of connections, ready or not.
    #[must_use]
    pub fn sessions(&self) -> usize {
        self.registry.sessions().iter().len()
    }

    /// Whether the HELLO of a session was granted.
    #[must_use]
    pub fn is_welcomed(&self, node: NodeId) -> bool {
        self.registry.sessions().record(node).is_some()
    }

    /// The number of links that are live at both ends.
    #[must_use]
    pub fn links(&self) -> usize {
        self.registry.links().len()
    }

    /// Whether the Manager holds back LINKs until a session's socket has taken all that was sent to
    /// it. The driver reports that with [`Input::Drained`].
    #[must_use]
    pub fn awaits_room(&self, node: NodeId) -> bool {
        self.registry.is_full(node)
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
            debug_assert_drained(&self.outbox.0);
        }
        if let Input::Connected { session, .. } = input
            && session <= self.last_node
        {
            return Err(Misuse::SessionNumber(session).into());
        }
        let before = self.registry.revision();
        self.expire_greetings(now);
        self.expire_claims(now);
        self.shortage.expire(now);
        while let Some(node) = self.counter_files.next_to_ask(now) {
            self.outbox.send(node, &ToNode::CountersLost);
        }
        match input {
            Input::Connected {
                session,
                credentials,
            } => self.connect(now, session, credentials),
            Input::Groups { session, gids } => self.registry.add_groups(session, gids),
            Input::Datagram { session, datagram } => self.receive(now, session, &datagram),
            Input::Closed { session } => self.end_session(session, Cause::Gone),
            Input::Stalled { session } => {
                self.end_session(session, Cause::Farewell(Farewell::Stalled));
            }
            Input::LinkFailed { link } => self.link_failed(now, link),
            Input::Drained { session } => self.registry.drained(session),
            Input::SetAccessPolicy(policy) => self.set_access_policy(policy),
            Input::AccessPolicyUnusable { problem, text } => {
                self.reload_requests.refuse(problem, text, &mut self.outbox);
            }
            Input::Tick => self.run_deferred(now),
            Input::DismissStandbys => self.dismiss_standbys(),
            Input::Shutdown => self.shut_down(),
        }
        let is_applying = |it| self.reload_requests.is_applying(it);
        if self.reload.is_confirmed(is_applying) {
            self.reload_requests.policy_is_applied(&mut self.outbox);
        }
        self.registry.wake_watchers(before, &mut self.outbox);
        self.due = self.has_deferred(now).then_some(now);
        debug_assert_eq!(self.broken_rule(), None);
        Ok(())
    }

    fn poll(&mut self) -> Option<Output> {
        self.outbox.0.pop_front()
    }

    /// The time of the next [`Input::Tick`]. A time in the past means: at once, but after all other
    /// inputs that have come, because a tick does only a part of the work.
    fn deadline(&self) -> Option<Instant> {
        let all = [
            self.registry.deadline(),
            self.shortage.deadline(),
            self.counter_files.deadline(),
            self.reload.deadline(),
            self.due,
        ];
        all.into_iter().flatten().min()
    }
}

impl Manager {
    //= SM2-SES-007
    fn connect(&mut self, now: Instant, node: NodeId, who: Credentials) {
        self.last_node = node;
        if !self.registry.connect(now, node, who) {
            self.end_session(node, Cause::Farewell(Farewell::Resources));
        }
    }

    //= SM2-SES-004
    fn expire_greetings(&mut self, now: Instant) {
        while let Some(node) = self.registry.pop_late(now) {
            self.end_session(node, Cause::Farewell(Farewell::GreetingTimeout));
        }
    }

    fn receive(&mut self, now: Instant, node: NodeId, datagram: &Datagram<'_>) {
        let Some(phase) = self.registry.sessions().get(node).map(Session::phase) else {
            return;
        };
        self.finish(node);
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
            ToManager::Query { after } => {
                let page = ToNode::Page(self.registry.page(node, after));
                self.outbox.send(node, &page);
            }
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
            ToManager::Watch { after } => self.registry.watch(node, after, &mut self.outbox)?,
            ToManager::Counters => {
                self.counter_files.keep(now, node, file, &mut self.outbox)?;
            }
            ToManager::Inspect { node: of } => {
                let is_allowed = self.registry.access().allows_inspection(node, of);
                self.counter_files
                    .answer(node, of, is_allowed, &mut self.outbox);
            }
            ToManager::Schema(text) => {
                let session = self.registry.session_mut(node);
                if let Some(record) = session.and_then(Session::node_mut) {
                    self.schemas.register(record, text, &self.limits)?;
                }
            }
            ToManager::Describe { data } => self.schemas.describe(node, data, &mut self.outbox),
            ToManager::MaxLinks { max_links } => self.registry.set_max_links(node, max_links),
            ToManager::Reload => {
                if let Some(session) = self.registry.sessions().get(node) {
                    let uid = session.credentials().uid;
                    self.reload_requests.ask(node, uid, &mut self.outbox)?;
                }
            }
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
        let Some(session) = self.registry.sessions().get(node) else {
            return Ok(());
        };
        let who = session.credentials();
        let versions = min..=max;
        let granted = if !versions.contains(&VERSION) {
            Err(Refusal::Version {
                min: VERSION,
                max: VERSION,
            })
        } else {
            self.registry.refuse_session(node, who, &name)
        };
        let answer = match granted {
            Err(reason) => ToNode::HelloRefused { reason },
            Ok(()) => {
                self.registry.welcome(node, name, resuming)?;
                ToNode::Welcome {
                    version: VERSION,
                    epoch: self.registry.links().epoch(),
                    node,
                }
            }
        };
        self.outbox.send(node, &answer);
        Ok(())
    }

    //= SM2-SES-005, SM2-SES-006
    fn end_session(&mut self, node: NodeId, cause: Cause) {
        let Some(session) = self.registry.end_session(node) else {
            return;
        };
        for data in session.node().into_iter().flat_map(NodeRecord::schemas) {
            self.schemas.remove(data);
        }
        self.reload.forget_session(node);
        self.reload_requests.forget(node);
        self.expired.remove(&node);
        self.counter_files.forget(node);
        self.work(node, &mut Budget::new(&self.limits));
        let goodbye = cause
            .code()
            .map(|code| encode_to_node(&ToNode::Goodbye { code }));
        self.outbox.push(Output::HangUp {
            session: node,
            goodbye,
            cause,
        });
    }

    /// Ends every session. Nodes hear nothing of their links, which live on.
    //= SM2-SES-008
    fn shut_down(&mut self) {
        self.registry.remove_links();
        let sessions = self.registry.sessions().iter();
        let sessions: Vec<NodeId> = sessions.map(|(node, _)| node).collect();
        for node in sessions {
            self.end_session(node, Cause::Farewell(Farewell::ShuttingDown));
        }
        self.finish_all();
    }

    /// Says goodbye to all standbys, which wait for the end of this Manager.
    //= SM2-RES-009
    fn dismiss_standbys(&mut self) {
        let sessions = self.registry.sessions().iter();
        let standbys = sessions.filter(|(_, session)| session.is_standby());
        let standbys: Vec<NodeId> = standbys.map(|(node, _)| node).collect();
        for node in standbys {
            self.end_session(node, Cause::Farewell(Farewell::ShuttingDown));
        }
    }

    /// The first invariant that does not hold.
    fn broken_rule(&self) -> Option<&'static str> {
        if !self.registry.is_to_be_checked() {
            return None;
        }
        let records = self.registry.sessions().records();
        let mut short = self.shortage.pairs();
        let mut waiting = self.reload_requests.sessions();
        let rules = [
            (
                self.schemas.are(records.flat_map(NodeRecord::schemas)),
                "each schema is there as often as sessions registered it",
            ),
            (
                short.all(|it| self.registry.may_be_linked(it)),
                "pairs that are to be linked again match, and have no link",
            ),
            (
                self.jobs_agree(),
                "busy sessions wait for their turn, and no others",
            ),
            (
                self.counter_files.agree(|it| self.is_welcomed(it)),
                "each file of counters belongs to a welcomed session",
            ),
            (
                waiting.all(|it| self.is_welcomed(it)),
                "each session that waits for a policy is welcomed",
            ),
        ];
        self.registry.broken_rule().or_else(|| broken(rules))
    }
}
