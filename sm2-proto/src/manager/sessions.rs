//! The sessions of all nodes, and what the other tables ask about these nodes and their interfaces.

use alloc::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use super::{
    Credentials,
    links::Pair,
    node_record::{NodeRecord, Remains},
    phase::Phase,
    session::Session,
    users::Users,
};
use crate::{
    Contract, EntityId, Instant, Name, NodeId, Refusal, Violation,
    control::{Item, Limit, Limits, LinkPeer},
};

/// The sessions by their numbers, with the names and the charges of their nodes.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Sessions {
    sessions: BTreeMap<NodeId, Session>,
    names: BTreeSet<Name>,
    users: Users,
    /// The latest time for each session that is not ready to be so. Sessions are numbered as they came, so the first
    /// deadline is the earliest.
    greeting: BTreeMap<NodeId, Instant>,
}

impl Sessions {
    pub(super) const fn new() -> Self {
        Self {
            sessions: BTreeMap::new(),
            names: BTreeSet::new(),
            users: Users::new(),
            greeting: BTreeMap::new(),
        }
    }

    /// Adds a connection. Returns whether the quotas allow it.
    pub(super) fn connect(
        &mut self,
        now: Instant,
        node: NodeId,
        who: Credentials,
        limits: &Limits,
    ) -> bool {
        self.sessions.insert(node, Session::new(who));
        self.greeting
            .insert(node, now.after(limits.time(Limit::Greeting)));
        self.users.connect(who, limits)
    }

    pub(super) fn deadline(&self) -> Option<Instant> {
        self.greeting.first_key_value().map(|(_, &it)| it)
    }

    /// Takes out a session that was to be ready by now.
    //= SM2-SES-004
    pub(super) fn pop_late(&mut self, now: Instant) -> Option<NodeId> {
        let first = self.greeting.first_entry()?;
        (*first.get() <= now).then(|| first.remove_entry().0)
    }

    /// Refuses a name that another node has, and the session of a user who has too many.
    //= SM2-SES-003
    pub(super) fn refuse(
        &self,
        who: Credentials,
        name: &Name,
        limits: &Limits,
    ) -> Result<(), Refusal> {
        if self.has_name(name) {
            return Err(Refusal::NameTaken);
        }
        self.users.refuse_session(who, limits)
    }

    /// Whether a welcomed node has this name.
    pub(super) fn has_name(&self, name: &Name) -> bool {
        self.names.contains(name)
    }

    /// Grants HELLO.
    //= SM2-SES-004
    pub(super) fn welcome(
        &mut self,
        node: NodeId,
        name: Name,
        resuming: bool,
    ) -> Result<(), Violation> {
        let Some(session) = self.sessions.get_mut(&node) else {
            return Ok(());
        };
        session.welcome(name.clone(), resuming)?;
        self.users.greet(session.credentials());
        self.names.insert(name);
        if !resuming {
            self.greeting.remove(&node);
        }
        Ok(())
    }

    /// A node has claimed all its links. Claims without a counterpart expire at `until`.
    //= SM2-SES-004
    pub(super) fn claimed(&mut self, node: NodeId, until: Option<Instant>) {
        if let Some(session) = self.sessions.remove(&node) {
            self.sessions.insert(node, session.claimed(until));
        }
        self.greeting.remove(&node);
    }

    /// Takes out a session that is over.
    pub(super) fn remove(&mut self, node: NodeId) -> Option<Session> {
        let session = self.sessions.remove(&node)?;
        self.greeting.remove(&node);
        let record = session.node();
        let interfaces = record.map_or(0, NodeRecord::interfaces);
        self.users
            .leave(session.credentials(), record.is_some(), interfaces);
        if let Some(record) = record {
            self.names.remove(record.name());
        }
        Some(session)
    }

    //= SM2-IFC-006
    pub(super) fn refuse_interface(&self, node: NodeId, limits: &Limits) -> Result<(), Refusal> {
        let Some(record) = self.record(node) else {
            return Ok(());
        };
        record.refuse_interface(limits)?;
        self.users.refuse_interface(record.credentials(), limits)
    }

    pub(super) fn declare(&mut self, entity: EntityId, contract: Arc<Contract>) {
        let session = self.sessions.get_mut(&entity.node);
        if let Some(record) = session.and_then(Session::node_mut) {
            self.users.declare(record.credentials());
            record.declare(entity.interface, contract);
        }
    }

    /// Removes an interface and returns its remains.
    pub(super) fn withdraw(&mut self, entity: EntityId) -> Option<Remains> {
        let record = self.record_mut(entity.node)?;
        let who = record.credentials();
        let remains = record.withdraw(entity.interface)?;
        self.users.withdraw(who, 1);
        Some(remains)
    }

    pub(super) fn get(&self, node: NodeId) -> Option<&Session> {
        self.sessions.get(&node)
    }

    pub(super) fn get_mut(&mut self, node: NodeId) -> Option<&mut Session> {
        self.sessions.get_mut(&node)
    }

    /// The record of a welcomed node.
    pub(super) fn record(&self, node: NodeId) -> Option<&NodeRecord> {
        self.get(node)?.node()
    }

    pub(super) fn record_mut(&mut self, node: NodeId) -> Option<&mut NodeRecord> {
        self.get_mut(node)?.node_mut()
    }

    /// In ascending order.
    pub(super) fn iter(&self) -> impl ExactSizeIterator<Item = (NodeId, &Session)> {
        self.sessions.iter().map(|(&node, it)| (node, it))
    }

    pub(super) fn records(&self) -> impl Iterator<Item = &NodeRecord> {
        self.sessions.values().filter_map(Session::node)
    }

    /// Whether a session may be linked: not before it has claimed all its links.
    //= SM2-RES-002, SM2-RES-007
    pub(super) fn may_link(&self, node: NodeId) -> bool {
        let phase = self.get(node).map(Session::phase);
        phase == Some(Phase::Ready)
    }

    pub(super) fn link_ends(&self, node: NodeId) -> usize {
        self.record(node).map_or(0, NodeRecord::link_ends)
    }

    /// A node of this pair that would have more than `limit` ends with one more link.
    pub(super) fn node_without_room(&self, pair: Pair, limit: usize) -> Option<NodeId> {
        pair.nodes()
            .find(|&it| self.link_ends(it) + pair.ends_at(it) > limit)
    }

    pub(super) fn contract(&self, entity: EntityId) -> Option<&Arc<Contract>> {
        self.record(entity.node)?.contract(entity.interface)
    }

    /// The user and the contract of an interface.
    pub(super) fn user_and_contract(&self, entity: EntityId) -> Option<(u32, &Contract)> {
        let record = self.record(entity.node)?;
        let contract = record.contract(entity.interface)?;
        Some((record.credentials().uid, contract))
    }

    /// An interface as LINK describes it to the other side.
    pub(super) fn peer(&self, EntityId { node, interface }: EntityId) -> Option<LinkPeer> {
        let record = self.record(node)?;
        Some(LinkPeer {
            node,
            name: record.name().clone(),
            interface,
            contract: Contract::clone(record.contract(interface)?),
        })
    }

    /// Why the access policy denies an interface, if it does.
    pub(super) fn suspension(&self, entity: EntityId) -> Option<&Refusal> {
        self.record(entity.node)?.suspended(entity.interface)
    }

    /// Whether there is this interface, and the policy does not deny it.
    pub(super) fn is_granted(&self, entity: EntityId) -> bool {
        self.contract(entity).is_some() && self.suspension(entity).is_none()
    }

    /// Whether both interfaces of a pair are there. Links of an interface that is gone may still
    /// have to be ended.
    pub(super) fn are_there(&self, pair: Pair) -> bool {
        pair.entities().into_iter().all(|it| self.is_granted(it))
    }

    /// The first welcomed node or interface from this one on.
    pub(super) fn member_from(&self, at: EntityId) -> Option<EntityId> {
        self.sessions.range(at.node..).find_map(|(&node, session)| {
            let record = session.node()?;
            if at <= EntityId::node(node) {
                return Some(EntityId::node(node));
            }
            let interface = record.interface_from(at.interface)?;
            Some(EntityId { node, interface })
        })
    }

    /// A node, interface or refusal as an item.
    pub(super) fn item(&self, entity: EntityId) -> Option<Item> {
        let session = self.get(entity.node)?;
        if entity == EntityId::node(entity.node) {
            node_item(entity.node, session)
        } else {
            session.node()?.member(entity)
        }
    }

    /// The nodes, interfaces and refusals after an id, in the order of their keys.
    pub(super) fn items(&self, after: EntityId) -> impl Iterator<Item = Item> {
        let rest = self.sessions.range(after.node..);
        rest.flat_map(move |(&node, session)| {
            let within = node == after.node;
            let itself = if within {
                None
            } else {
                node_item(node, session)
            };
            let after = if within { after } else { EntityId::node(node) };
            let record = session.node().into_iter();
            itself
                .into_iter()
                .chain(record.flat_map(move |it| it.members(after)))
        })
    }

    /// The first rule between the sessions, names, charges and deadlines that does not hold.
    pub(super) fn broken_rule(&self, limits: &Limits) -> Option<&'static str> {
        let not_ready = self.iter().filter(|(_, it)| it.phase() != Phase::Ready);
        let refusals = limits.count(Limit::RefusalsPerSession);
        let rules = [
            (
                self.records().count() == self.names.len(),
                "each welcomed session has one name, and each name one",
            ),
            (
                not_ready
                    .map(|(node, _)| node)
                    .eq(self.greeting.keys().copied()),
                "each session that is not ready has a deadline, and no other one",
            ),
            (
                self.records().all(|it| it.refused().len() <= refusals),
                "refusals are remembered within their quota",
            ),
            (
                self.records().all(NodeRecord::counts_its_ends),
                "each session knows how many ends of links it has",
            ),
            (
                self.users.are(self.sessions.values()),
                "charges per user equal a recount",
            ),
        ];
        broken(rules)
    }
}

/// The first rule that does not hold.
pub(super) fn broken(
    rules: impl IntoIterator<Item = (bool, &'static str)>,
) -> Option<&'static str> {
    let mut rules = rules.into_iter();
    rules.find(|(holds, _)| !holds).map(|(_, rule)| rule)
}

/// A session as an item, once it is welcomed.
fn node_item(node: NodeId, session: &Session) -> Option<Item> {
    let record = session.node()?;
    Some(Item::Node {
        node,
        name: record.name().clone(),
        uid: record.credentials().uid,
        pid: record.credentials().pid,
        resuming: session.phase() == Phase::Resuming,
        max_links: record.max_links(),
    })
}
