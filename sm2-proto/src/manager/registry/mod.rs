//! The nodes of the domain, their interfaces, links and claims, and the pairs that are not linked. Each of these is an
//! item that QUERY and WATCH show.
//!
//! An item changes only by a method of [`Registry`], which notes the change in the log, so that pages and changes
//! together are exact (SM2-WCH-003). The registry sends no frame and waits for nothing: which interfaces and links
//! there should be is decided by the Manager.

mod flow_control;
mod invariants;
mod page;
mod watch;

use alloc::{collections::BTreeSet, sync::Arc, vec::Vec};

use super::{
    Credentials,
    access::Access,
    channel::{Channel, Channels},
    claims::{Claim, Claims},
    ending_links::EndingLinks,
    links::{Agreed, Links, Pair},
    log::Log,
    node_record::Remains,
    pending_links::PendingLinks,
    session::Session,
    sessions::Sessions,
    unlinked::UnlinkedPairs,
};
use crate::{
    Contract, EntityId, Farewell, Instant, LinkId, LinkKey, Name, NodeId, Refusal, Violation,
    control::{Key, Limit, Limits, UnlinkedReason},
    policy::AccessPolicy,
};

/// The tables of a domain.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Registry {
    limits: Limits,
    log: Log,
    access: Access,
    sessions: Sessions,
    channels: Channels,
    links: Links,
    claims: Claims,
    unlinked_pairs: UnlinkedPairs,
    /// The links that no node was told of.
    pub(super) pending_links: PendingLinks,
    /// The links whose interfaces are gone.
    pub(super) ending_links: EndingLinks,
    /// The sessions that wait for a change of the domain.
    watchers: BTreeSet<NodeId>,
}

/// Reading.
impl Registry {
    pub(super) const fn new(epoch: u64, secret: u128, limits: Limits) -> Self {
        Self {
            limits,
            log: Log::new(limits.count(Limit::ChangesRemembered)),
            access: Access::new(),
            sessions: Sessions::new(),
            channels: Channels::new(),
            links: Links::new(epoch, secret),
            claims: Claims::new(),
            unlinked_pairs: UnlinkedPairs::new(),
            pending_links: PendingLinks::new(),
            ending_links: EndingLinks::new(),
            watchers: BTreeSet::new(),
        }
    }

    pub(super) const fn revision(&self) -> u64 {
        self.log.revision()
    }

    pub(super) const fn access(&self) -> &Access {
        &self.access
    }

    pub(super) const fn sessions(&self) -> &Sessions {
        &self.sessions
    }

    /// A session, to change what no item shows.
    pub(super) fn session_mut(&mut self, node: NodeId) -> Option<&mut Session> {
        self.sessions.get_mut(node)
    }

    pub(super) fn channel(&self, contract: &Contract) -> Option<&Channel> {
        self.channels.get(contract)
    }

    pub(super) const fn links(&self) -> &Links {
        &self.links
    }

    /// The earliest time when a session is late, or when claims expire.
    pub(super) fn deadline(&self) -> Option<Instant> {
        let deadlines = [self.sessions.deadline(), self.claims.deadline()];
        deadlines.into_iter().flatten().min()
    }

    fn changed(&mut self, key: Key) {
        self.log.push(key);
    }

    fn node_changed(&mut self, node: NodeId) {
        self.member_changed(EntityId::node(node));
    }

    fn member_changed(&mut self, entity: EntityId) {
        self.changed(Key::Member { entity });
    }

    fn link_changed(&mut self, link: LinkId, pair: Pair) {
        let offering = pair.offering;
        self.changed(Key::Link { link, offering });
    }
}

/// Sessions.
impl Registry {
    /// Adds a connection. Returns whether the quotas allow it.
    pub(super) fn connect(&mut self, now: Instant, node: NodeId, who: Credentials) -> bool {
        self.sessions.connect(now, node, who, &self.limits)
    }

    pub(super) fn add_groups(&mut self, node: NodeId, gids: &[u32]) {
        if self.sessions.get(node).is_some() {
            self.access.add_groups(node, gids);
        }
    }

    /// Takes out a session that was to be ready by now.
    pub(super) fn pop_late(&mut self, now: Instant) -> Option<NodeId> {
        self.sessions.pop_late(now)
    }

    //= SM2-SES-003
    pub(super) fn refuse_session(
        &self,
        node: NodeId,
        who: Credentials,
        name: &Name,
    ) -> Result<(), Refusal> {
        self.access.refuse_name(node, who, name)?;
        self.sessions.refuse(who, name, &self.limits)
    }

    /// Grants HELLO.
    pub(super) fn welcome(
        &mut self,
        node: NodeId,
        name: Name,
        resuming: bool,
    ) -> Result<(), Violation> {
        self.sessions.welcome(node, name, resuming)?;
        if let Some(record) = self.sessions.record(node) {
            self.access
                .welcome(node, record.credentials(), record.name());
        }
        self.node_changed(node);
        Ok(())
    }

    /// A node has claimed all its links. Claims without a counterpart expire at `until`.
    pub(super) fn claimed(&mut self, node: NodeId, until: Option<Instant>) {
        self.sessions.claimed(node, until);
        if let Some(until) = until {
            self.claims.expire_at(until, node);
        }
        self.node_changed(node);
    }

    /// Takes out a session whose claims have expired.
    pub(super) fn pop_expired(&mut self, now: Instant) -> Option<NodeId> {
        while let Some(node) = self.claims.pop_expired(now) {
            if let Some(session) = self.sessions.get_mut(node) {
                session.claims_expired();
                return Some(node);
            }
        }
        None
    }

    /// Removes a session, and the node with all that it registered. Its links are still to be ended.
    //= SM2-SES-005, SM2-SES-006
    pub(super) fn end_session(&mut self, node: NodeId) -> Option<Session> {
        let mut session = self.sessions.remove(node)?;
        if let Some(until) = session.claims_until() {
            self.claims.forget(until, node);
        }
        if let Some(record) = session.node_mut() {
            self.node_changed(node);
            let entity = |interface| EntityId { node, interface };
            for interface in record.refused() {
                self.member_changed(entity(interface));
            }
            for interface in record.interface_ids() {
                if let Some(remains) = record.withdraw(interface) {
                    self.end_interface(entity(interface), remains, Farewell::PeerGone);
                }
            }
        }
        self.access.end(node);
        self.pending_links.forget_session(node);
        self.watchers.remove(&node);
        Some(session)
    }

    /// Sets the access policy. Each session may see other items from now on.
    //= SM2-ACC-013
    pub(super) fn set_policy(&mut self, policy: Option<Arc<AccessPolicy>>) {
        if self.access.set_policy(policy) {
            self.log.forget();
        }
    }
}

/// Interfaces.
impl Registry {
    pub(super) fn refuse_quotas(&self, node: NodeId) -> Result<(), Refusal> {
        self.sessions.refuse_interface(node, &self.limits)
    }

    /// Adds an interface that is granted.
    pub(super) fn declare(&mut self, entity: EntityId, contract: &Arc<Contract>) {
        self.channels.insert(entity, contract);
        self.sessions.declare(entity, Arc::clone(contract));
        self.supersede(entity.node, contract);
        self.member_changed(entity);
    }

    /// Adds an interface that an earlier Manager granted and that the policy denies.
    //= SM2-RES-010
    pub(super) fn declare_suspended(
        &mut self,
        entity: EntityId,
        contract: Contract,
        reason: Refusal,
    ) {
        self.sessions.declare(entity, Arc::new(contract));
        self.suspend(entity, reason);
    }

    /// Remembers a refusal.
    //= SM2-WCH-004
    pub(super) fn refuse(&mut self, entity: EntityId, contract: Contract, reason: Refusal) {
        let limit = self.limits.count(Limit::RefusalsPerSession);
        let Some(record) = self.sessions.record_mut(entity.node) else {
            return;
        };
        let forgotten = record.refuse(entity.interface, contract, reason, limit);
        self.member_changed(entity);
        if let Some(interface) = forgotten {
            self.member_changed(EntityId {
                interface,
                ..entity
            });
        }
    }

    /// Forgets the refusals of a session that an interface with this contract supersedes.
    //= SM2-WCH-004
    fn supersede(&mut self, node: NodeId, contract: &Contract) {
        let record = self.sessions.record_mut(node);
        let superseded = record.map(|it| it.supersede(contract));
        for interface in superseded.into_iter().flatten() {
            self.member_changed(EntityId { node, interface });
        }
    }

    /// Takes an interface off its channel, or notes another reason why it is suspended.
    //= SM2-ACC-013
    pub(super) fn suspend(&mut self, entity: EntityId, reason: Refusal) {
        let EntityId { node, interface } = entity;
        if let Some(record) = self.sessions.record_mut(node) {
            if let Some(contract) = record.contract(interface)
                && record.suspended(interface).is_none()
            {
                self.channels.remove(entity, contract);
            }
            record.set_suspended(interface, Some(reason));
        }
        self.member_changed(entity);
    }

    /// Ends the suspension of an interface.
    //= SM2-ACC-013
    pub(super) fn resume(&mut self, entity: EntityId, contract: &Arc<Contract>) {
        let EntityId { node, interface } = entity;
        if let Some(record) = self.sessions.record_mut(node) {
            record.set_suspended(interface, None);
        }
        self.channels.insert(entity, contract);
        self.supersede(node, contract);
        self.member_changed(entity);
    }

    /// Removes an interface that its node gives up. Its links are still to be ended.
    //= SM2-IFC-003
    pub(super) fn withdraw(&mut self, entity: EntityId) -> Result<(), Violation> {
        let was_short = self.is_short_of_ends(entity.node);
        let remains = self.sessions.withdraw(entity);
        let remains = remains.ok_or(violation!(UnknownInterface, "SM2-IFC-003"))?;
        //= SM2-LNK-007
        if was_short {
            self.pending_links.has_room(entity.node);
        }
        self.end_interface(entity, remains, Farewell::Done);
        Ok(())
    }

    //= SM2-IFC-003, SM2-SES-006, SM2-SES-009
    fn end_interface(&mut self, entity: EntityId, (contract, links): Remains, cause: Farewell) {
        self.channels.remove(entity, &contract);
        self.access.begin_end(entity, &contract);
        self.member_changed(entity);
        self.ending_links.insert(entity, cause, links);
    }

    /// All links of an interface that is gone have ended.
    pub(super) fn complete_end(&mut self, entity: EntityId) {
        self.ending_links.remove(entity);
        self.access.complete_end(entity);
    }
}

/// Links and claims.
impl Registry {
    /// The number and the key of a new link.
    pub(super) fn number_link(&mut self) -> (LinkId, LinkKey) {
        self.links.number()
    }

    /// Inserts a link that was made or adopted. `announced`: its LINKs are sent at once.
    pub(super) fn insert_link(
        &mut self,
        link: LinkId,
        pair: Pair,
        agreed: Agreed,
        announced: bool,
    ) {
        self.links.insert(link, pair, agreed);
        for entity in pair.entities() {
            if let Some(record) = self.sessions.record_mut(entity.node) {
                record.link(entity.interface, link, pair);
                if announced {
                    record.announce(entity.interface);
                }
            }
        }
        self.mark_linked(pair);
        self.link_changed(link, pair);
    }

    /// Removes a live link. Returns whether it was live.
    pub(super) fn remove_link(&mut self, link: LinkId, pair: Pair) -> bool {
        let was_live = self.links.remove(link, pair);
        if was_live {
            self.link_changed(link, pair);
        }
        was_live
    }

    /// Removes all links. No node is told.
    //= SM2-SES-008
    pub(super) fn remove_links(&mut self) {
        for (link, pair) in self.links.iter().collect::<Vec<_>>() {
            self.pending_links.remove(pair, link);
            self.remove_link(link, pair);
        }
    }

    /// Removes an end of a link that its session was never told of. Its interface may be gone, and
    /// its links are then being ended.
    pub(super) fn remove_end(&mut self, entity: EntityId, link: LinkId) {
        if let Some(record) = self.sessions.record_mut(entity.node) {
            record.remove_link(entity.interface, link);
        }
        self.ending_links.forget(entity, link);
    }

    /// Takes back a link that the driver could not make, with its two LINKs. Returns its pair.
    //= SM2-LNK-008
    pub(super) fn take_back(&mut self, link: LinkId) -> Option<Pair> {
        let pair = self.links.made(link)?;
        if self.pending_links.contains(pair.offering.node, link) {
            // The link is pending: the driver was not asked to make it yet.
            return None;
        }
        self.remove_link(link, pair);
        for entity in pair.entities() {
            self.remove_end(entity, link);
        }
        self.not_sent(pair);
        Some(pair)
    }

    /// Notes that a live end of a link is sent UNLINK. `again`: its UNLINKED can be the reason to
    /// link the pair again. Returns whether the end is still there: the interface may be gone, and
    /// its links are then being ended.
    pub(super) fn begin_unlink(&mut self, entity: EntityId, link: LinkId, again: bool) -> bool {
        let EntityId { node, interface } = entity;
        let record = self.sessions.record(node);
        let pair = record
            .and_then(|it| it.live_link(interface, link))
            .flatten();
        let pair = pair.filter(|&it| again && self.sessions.are_there(it));
        let record = self.sessions.record_mut(node);
        let is_live = record.is_some_and(|it| it.begin_unlink(interface, link, pair));
        if !is_live {
            self.ending_links.forget(entity, link);
        }
        is_live
    }

    /// Adds a claim. If its counterpart waits, the two meet, and the counterpart is returned.
    //= SM2-RES-004
    pub(super) fn claim(
        &mut self,
        entity: EntityId,
        link: LinkId,
        claim: Claim,
    ) -> Option<EntityId> {
        let other = self.claims.meet(link, entity, claim);
        let entity = other.unwrap_or(entity);
        self.changed(Key::Claim { link, entity });
        other
    }

    /// Removes a claim without telling any node.
    pub(super) fn give_up_claim(&mut self, entity: EntityId, link: LinkId) {
        if self.claims.remove(link, entity) {
            self.changed(Key::Claim { link, entity });
        }
    }

    /// Remembers why a matching pair is not linked, as far as the quota allows. An interface that
    /// is gone has no match.
    //= SM2-WCH-004
    pub(super) fn mark_unlinked(&mut self, pair: Pair, reason: UnlinkedReason) {
        let limit = self.limits.count(Limit::UnlinkedPerSession);
        if self.sessions.are_there(pair) && self.unlinked_pairs.insert(pair, reason, limit) {
            self.changed(unlinked(pair));
        }
    }

    /// Forgets why a pair was not linked.
    fn mark_linked(&mut self, pair: Pair) {
        if self.unlinked_pairs.remove(pair) {
            self.changed(unlinked(pair));
        }
    }

    /// Forgets one pair of an interface that is gone or suspended. Returns whether there was one.
    pub(super) fn forget_unlinked(&mut self, entity: EntityId) -> bool {
        let pair = self.unlinked_pairs.first_of(entity);
        pair.map(|it| self.mark_linked(it)).is_some()
    }
}

const fn unlinked(pair: Pair) -> Key {
    Key::Unlinked {
        offering: pair.offering,
        demanding: pair.demanding,
    }
}
