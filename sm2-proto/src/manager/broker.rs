//! Grants interfaces and links those that match (SPEC sections 4.3, 4.4 and 5).

use alloc::{sync::Arc, vec::Vec};

use super::{
    Manager, Output,
    budget::{Budget, LINK, MARK, PAIR},
    channel::Channel,
    links::{Agreed, Pair},
    node_record::NodeRecord,
    phase::Phase,
    quota::{count, within},
    session::Session,
};
use crate::{
    Contract, EntityId, InterfaceId, Kind, LinkId, LinkKey, LinkQos, NodeId, Quota, Refusal,
    VERSION, Violation,
    control::{Key, Limit, LinkPeer, ToNode, UnlinkedReason, encode_to_node},
    match_contracts,
};

impl Manager {
    pub(super) fn declare(
        &mut self,
        entity: EntityId,
        contract: Contract,
    ) -> Result<(), Violation> {
        let record = self.sessions.get_mut(&entity.node);
        let Some(record) = record.and_then(Session::node_mut) else {
            return Ok(());
        };
        record.number(entity.interface)?;
        match self.check_interface(entity.node, &contract) {
            Ok(()) => self.grant(entity, contract),
            Err(reason) if reason.is_denial() && !self.may_link(entity.node) => {
                self.declare_denied(entity, contract, reason);
            }
            Err(reason) => self.refuse(entity, contract, reason),
        }
        Ok(())
    }

    /// Keeps an interface that an earlier Manager granted and that the policy denies.
    //= SM2-RES-010
    fn declare_denied(&mut self, entity: EntityId, contract: Contract, reason: Refusal) {
        if let Err(reason) = self.check_quotas(entity.node) {
            return self.refuse(entity, contract, reason);
        }
        let record = self.sessions.get_mut(&entity.node);
        let Some(record) = record.and_then(Session::node_mut) else {
            return;
        };
        self.users.declare(record.credentials());
        record.declare(entity.interface, Arc::new(contract));
        self.suspend(entity, reason);
    }

    /// Checks whether an interface can be granted.
    //= SM2-IFC-005, SM2-IFC-006, SM2-RES-008
    fn check_interface(&self, node: NodeId, contract: &Contract) -> Result<(), Refusal> {
        let Some(session) = self.sessions.get(&node) else {
            return Ok(());
        };
        let channel = self.channels.get(contract);
        let publishers = channel.map_or(0, |it| it.counterpart_count(Kind::Subscriber));
        (self.access).refuse_interface(node, contract, publishers)?;
        self.check_quotas(node)?;
        let Some(channel) = channel else {
            return Ok(());
        };
        channel.refuse_types(contract)?;
        //= SM2-RES-002
        if session.phase() == Phase::Resuming {
            return Ok(());
        }
        self.check_links(self.link_ends(node), node, contract, channel)
    }

    //= SM2-IFC-006
    fn check_quotas(&self, node: NodeId) -> Result<(), Refusal> {
        let Some(record) = self.node(node) else {
            return Ok(());
        };
        record.refuse_interface(&self.limits)?;
        self.users
            .refuse_interface(record.credentials(), &self.limits)
    }

    /// Whether a session may be linked: not before it has claimed all its links.
    //= SM2-RES-002, SM2-RES-007
    pub(super) fn may_link(&self, node: NodeId) -> bool {
        let phase = self.sessions.get(&node).map(Session::phase);
        phase == Some(Phase::Ready)
    }

    /// Checks whether a session that has `ours` ends of links may have those of a new interface.
    //= SM2-MAT-002
    fn check_links(
        &self,
        mut ours: usize,
        node: NodeId,
        contract: &Contract,
        channel: &Channel,
    ) -> Result<(), Refusal> {
        let limit = self.limits.links_per_session();
        // If the quota has room for a link with each counterpart, none has to be compared. A link
        // within the session has two ends there.
        if ours + 2 * channel.counterpart_count(contract.kind()) <= limit {
            return Ok(());
        }
        // The interfaces of a session stand together in this order, so one other count is enough.
        let mut theirs = (node, 0);
        for other in channel.matches(contract) {
            if !self.may_link(other.node) {
                continue;
            }
            if other.node == node {
                // Both ends of the link belong to this session.
                ours += 1;
            } else {
                if other.node != theirs.0 {
                    theirs = (other.node, self.link_ends(other.node));
                }
                if theirs.1 >= limit {
                    continue;
                }
                theirs.1 += 1;
            }
            ours += 1;
            within(limit, ours, Quota::LinksPerSession)?;
        }
        Ok(())
    }

    fn node(&self, node: NodeId) -> Option<&NodeRecord> {
        self.sessions.get(&node).and_then(Session::node)
    }

    fn link_ends(&self, node: NodeId) -> usize {
        self.node(node).map_or(0, NodeRecord::link_ends)
    }

    /// Grants an interface, answers, and links it as far as the budget of one part allows. Later
    /// parts link it with its other matches.
    //= SM2-IFC-002, SM2-LNK-006, SM2-SES-009
    fn grant(&mut self, entity: EntityId, contract: Contract) {
        let record = self.sessions.get_mut(&entity.node);
        let Some(record) = record.and_then(Session::node_mut) else {
            return;
        };
        self.users.declare(record.credentials());
        let contract = Arc::new(contract);
        self.channels.insert(entity, &contract);
        record.declare(entity.interface, Arc::clone(&contract));
        self.supersede(entity.node, &contract);
        self.member_changed(entity);
        let mut budget = Budget::of_declare(&self.limits);
        //= SM2-RES-002
        let (links, more) = if self.may_link(entity.node) {
            self.link_missing(entity, EntityId::FIRST, &mut budget)
        } else {
            (Vec::new(), None)
        };
        // DECLARED comes first. It counts only the LINKs that follow at once: a link that waits may
        // end before its LINKs are sent.
        let (interface, matches) = (entity.interface, count(links.len()));
        self.send(entity.node, &ToNode::Declared { interface, matches });
        self.outputs.extend(links);
        if let Some(after) = more
            && let Some(session) = self.sessions.get_mut(&entity.node)
        {
            session.begin_matching(entity.interface, after);
            self.jobs.insert(entity.node);
        }
        let spent = Budget::of_declare(&self.limits).left() - budget.left();
        self.jobs.charge(entity.node, spent);
    }

    /// Forgets the refusals of a session that an interface with this contract supersedes.
    //= SM2-WCH-004
    pub(super) fn supersede(&mut self, node: NodeId, contract: &Contract) {
        let record = self.sessions.get_mut(&node).and_then(Session::node_mut);
        let superseded = record.map(|it| it.supersede(contract));
        for interface in superseded.into_iter().flatten() {
            self.member_changed(EntityId { node, interface });
        }
    }

    //= SM2-WCH-004
    fn refuse(&mut self, entity: EntityId, contract: Contract, reason: Refusal) {
        let EntityId { node, interface } = entity;
        let limit = self.limits.count(Limit::RefusalsPerSession);
        let record = self.sessions.get_mut(&node);
        let Some(record) = record.and_then(Session::node_mut) else {
            return;
        };
        let forgotten = record.refuse(interface, contract, reason.clone(), limit);
        self.member_changed(entity);
        if let Some(interface) = forgotten {
            self.member_changed(EntityId {
                interface,
                ..entity
            });
        }
        self.send(node, &ToNode::DeclareRefused { interface, reason });
    }

    pub(super) fn member_changed(&mut self, entity: EntityId) {
        self.changed(Key::Member { entity });
    }

    fn quota(&self, node: NodeId) -> UnlinkedReason {
        let limit = count(self.limits.links_per_session());
        UnlinkedReason::Quota { node, limit }
    }

    /// Links an interface with each match that it has no link with, as far as the quotas of both
    /// sides allow. Pairs that ended their link are left out. Starts with the counterpart after
    /// `after`, and stops when the budget is spent. Returns the LINKs that are to be sent at once,
    /// and the last counterpart if some may be left.
    //= SM2-RES-007, SM2-LNK-009, SM2-SES-009
    pub(super) fn link_missing(
        &mut self,
        entity: EntityId,
        after: EntityId,
        budget: &mut Budget,
    ) -> (Vec<Output>, Option<EntityId>) {
        // An interface without counterparts costs something, too.
        budget.spend(PAIR);
        let session = self.sessions.get(&entity.node);
        let record = session.and_then(Session::node);
        let record = record.filter(|it| it.suspended(entity.interface).is_none());
        let contract = record
            .and_then(|it| it.contract(entity.interface))
            .map(Arc::clone);
        let (Some(session), Some(contract)) = (session, contract) else {
            return (Vec::new(), None);
        };
        let mut more = None;
        let mut missing = Vec::new();
        if let Some(channel) = self.channels.get(&contract) {
            for (other, matches) in channel.counterparts(&contract, after) {
                budget.spend(PAIR);
                let pair = Pair::new(entity, &contract, other);
                if matches
                    && self.may_link(other.node)
                    && !self.links.joins(pair)
                    && !session.has_ended(pair)
                {
                    let is_full = self.node_without_room(pair).is_some();
                    budget.spend(if is_full { MARK } else { LINK });
                    missing.push(other);
                }
                if budget.is_spent() {
                    more = Some(other);
                    break;
                }
            }
        }
        let mut links = Vec::new();
        for other in missing {
            let pair = Pair::new(entity, &contract, other);
            match self.node_without_room(pair) {
                Some(node) => self.mark_unlinked(pair, self.quota(node)),
                None => links.extend(self.link(entity, other)),
            }
        }
        (links, more)
    }

    /// Links pairs again that could not be linked for want of descriptors or memory.
    //= SM2-LNK-008, SM2-LNK-009, SM2-SES-009
    pub(super) fn link_again(&mut self) {
        let mut budget = Budget::new(&self.limits);
        while !budget.is_spent()
            && let Some(pair) = self.shortage.pop()
        {
            budget.spend(LINK);
            match self.node_without_room(pair) {
                _ if self.links.joins(pair) || !self.is_there(pair) => {}
                Some(node) => self.mark_unlinked(pair, self.quota(node)),
                None => {
                    let links = self.link(pair.offering, pair.demanding);
                    self.outputs.extend(links);
                }
            }
        }
    }

    /// A node of this pair whose quota has no room for one more link.
    fn node_without_room(&self, pair: Pair) -> Option<NodeId> {
        let limit = self.limits.links_per_session();
        let mut nodes = pair.entities().map(|it| it.node).into_iter();
        let ends = |node| pair.entities().iter().filter(|it| it.node == node).count();
        nodes.find(|&node| self.link_ends(node) + ends(node) > limit)
    }

    /// Makes a link between a pair. Returns its LINKs unless they have to wait.
    //= SM2-LNK-001, SM2-LNK-002, SM2-MAT-002, SM2-MAT-003, SM2-VER-002
    fn link(&mut self, one: EntityId, other: EntityId) -> Option<Output> {
        let (Some((us, ours)), Some((them, theirs))) = (self.end(one), self.end(other)) else {
            return None;
        };
        let qos = match_contracts(ours, theirs).ok()?;
        let pair = Pair::new(one, ours, other);
        let agreed = Agreed {
            version: VERSION,
            qos: LinkQos {
                sealed: qos.sealed
                    || (self.limits).seals(us.credentials().uid == them.credentials().uid),
                ..qos
            },
        };
        let waits = self.must_wait(pair);
        let (link, key) = self.links.number();
        self.insert_link(link, pair, agreed, !waits);
        if waits {
            self.pending_links.insert(pair, link);
            return None;
        }
        self.announcement((link, key), [one, other], agreed)
    }

    /// The two LINKs of a live link.
    //= SM2-LNK-001, SM2-LNK-002, SM2-LNK-006
    pub(super) fn announcement(
        &self,
        (link, key): (LinkId, LinkKey),
        [one, other]: [EntityId; 2],
        agreed: Agreed,
    ) -> Option<Output> {
        let (ours, theirs) = (self.peer(one)?, self.peer(other)?);
        let frame = |interface: InterfaceId, peer: LinkPeer| {
            encode_to_node(&ToNode::Link {
                interface,
                link,
                key,
                version: agreed.version,
                reliable: agreed.qos.reliable,
                sealed: agreed.qos.sealed,
                peer,
            })
        };
        let ends = [
            (one.node, frame(one.interface, theirs)),
            (other.node, frame(other.interface, ours)),
        ];
        Some(Output::Link { link, ends })
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
            let node = self.sessions.get_mut(&entity.node);
            if let Some(record) = node.and_then(Session::node_mut) {
                record.link(entity.interface, link, pair);
                if announced {
                    record.announce(entity.interface);
                }
            }
        }
        self.mark_linked(pair);
        self.shortage.remove(pair);
        let offering = pair.offering;
        self.changed(Key::Link { link, offering });
    }

    /// Removes a live link. Returns whether it was live.
    pub(super) fn forget_link(&mut self, link: LinkId, pair: Pair) -> bool {
        let was_live = self.links.remove(link, pair);
        if was_live {
            let offering = pair.offering;
            self.changed(Key::Link { link, offering });
        }
        was_live
    }

    /// The user and the contract of an interface.
    pub(super) fn user_and_contract(&self, entity: EntityId) -> Option<(u32, &Contract)> {
        let (record, contract) = self.end(entity)?;
        Some((record.credentials().uid, contract))
    }

    fn end(&self, entity: EntityId) -> Option<(&NodeRecord, &Contract)> {
        let record = self.node(entity.node)?;
        let contract = record.contract(entity.interface)?;
        Some((record, contract))
    }

    /// An interface as LINK describes it to the other side.
    fn peer(&self, EntityId { node, interface }: EntityId) -> Option<LinkPeer> {
        let record = self.node(node)?;
        Some(LinkPeer {
            node,
            name: record.name().clone(),
            interface,
            contract: Contract::clone(record.contract(interface)?),
        })
    }
}
