//! Grants interfaces and links those that match (SPEC sections 4.3, 4.4 and 5).

use alloc::{sync::Arc, vec::Vec};

use super::{
    Manager, Output,
    budget::{Budget, LINK, MARK, PAIR},
    channel::Channel,
    links::{Agreed, Pair},
    quota::{count, within},
    session::Session,
};
use crate::{
    Contract, EntityId, InterfaceId, Kind, LinkId, LinkKey, LinkQos, NodeId, Quota, Refusal,
    VERSION, Violation,
    control::{LinkPeer, ToNode, UnlinkedReason, encode_to_node},
    match_contracts,
};

impl Manager {
    pub(super) fn declare(
        &mut self,
        entity: EntityId,
        contract: Contract,
    ) -> Result<(), Violation> {
        let session = self.registry.session_mut(entity.node);
        let Some(record) = session.and_then(Session::node_mut) else {
            return Ok(());
        };
        record.number(entity.interface)?;
        let may_link = self.registry.sessions().may_link(entity.node);
        match self.check_interface(entity.node, &contract) {
            Ok(()) => self.grant(entity, contract),
            Err(reason) if reason.is_denial() && !may_link => {
                self.declare_denied(entity, contract, reason);
            }
            Err(reason) => self.refuse(entity, contract, reason),
        }
        Ok(())
    }

    /// Keeps an interface that an earlier Manager granted and that the policy denies.
    //= SM2-RES-010
    fn declare_denied(&mut self, entity: EntityId, contract: Contract, reason: Refusal) {
        if let Err(reason) = self.registry.refuse_quotas(entity.node) {
            return self.refuse(entity, contract, reason);
        }
        self.registry
            .declare_suspended(entity, contract, reason.clone());
        self.send_refusal(entity, reason);
    }

    /// Checks whether an interface can be granted.
    //= SM2-IFC-005, SM2-IFC-006, SM2-RES-008
    fn check_interface(&self, node: NodeId, contract: &Contract) -> Result<(), Refusal> {
        let sessions = self.registry.sessions();
        let channel = self.registry.channel(contract);
        let publishers = channel.map_or(0, |it| it.counterpart_count(Kind::Subscriber));
        let access = self.registry.access();
        access.refuse_interface(node, contract, publishers)?;
        self.registry.refuse_quotas(node)?;
        let Some(channel) = channel else {
            return Ok(());
        };
        channel.refuse_types(contract)?;
        //= SM2-RES-002
        if !sessions.may_link(node) {
            return Ok(());
        }
        self.check_links(sessions.link_ends(node), node, contract, channel)
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
        let sessions = self.registry.sessions();
        // If the quota has room for a link with each counterpart, none has to be compared. A link
        // within the session has two ends there.
        if ours + 2 * channel.counterpart_count(contract.kind()) <= limit {
            return Ok(());
        }
        // The interfaces of a session stand together in this order, so one other count is enough.
        let mut theirs = (node, 0);
        for other in channel.matches(contract) {
            if !sessions.may_link(other.node) {
                continue;
            }
            if other.node == node {
                // Both ends of the link belong to this session.
                ours += 1;
            } else {
                if other.node != theirs.0 {
                    theirs = (other.node, sessions.link_ends(other.node));
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

    /// Grants an interface, answers, and links it as far as the budget of one part allows. Later
    /// parts link it with its other matches.
    //= SM2-IFC-002, SM2-LNK-006, SM2-SES-009
    fn grant(&mut self, entity: EntityId, contract: Contract) {
        self.registry.declare(entity, &Arc::new(contract));
        let mut budget = Budget::of_declare(&self.limits);
        //= SM2-RES-002
        let (links, more) = if self.registry.sessions().may_link(entity.node) {
            self.link_missing(entity, EntityId::FIRST, &mut budget)
        } else {
            (Vec::new(), None)
        };
        // DECLARED comes first. It counts only the LINKs that follow at once: a link that waits may
        // end before its LINKs are sent.
        let (interface, matches) = (entity.interface, count(links.len()));
        self.outbox
            .send(entity.node, &ToNode::Declared { interface, matches });
        self.outbox.extend(links);
        if let Some(after) = more
            && let Some(session) = self.registry.session_mut(entity.node)
        {
            session.begin_matching(entity.interface, after);
            self.jobs.insert(entity.node);
        }
        let spent = Budget::of_declare(&self.limits).left() - budget.left();
        self.jobs.charge(entity.node, spent);
    }

    fn refuse(&mut self, entity: EntityId, contract: Contract, reason: Refusal) {
        self.registry.refuse(entity, contract, reason.clone());
        self.send_refusal(entity, reason);
    }

    pub(super) fn send_refusal(&mut self, EntityId { node, interface }: EntityId, reason: Refusal) {
        self.outbox
            .send(node, &ToNode::DeclareRefused { interface, reason });
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
        let sessions = self.registry.sessions();
        let session = sessions.get(entity.node);
        let contract = sessions.contract(entity);
        let contract = contract.filter(|_| sessions.suspension(entity).is_none());
        let (Some(session), Some(contract)) = (session, contract.cloned()) else {
            return (Vec::new(), None);
        };
        let mut more = None;
        let mut missing = Vec::new();
        if let Some(channel) = self.registry.channel(&contract) {
            for (other, matches) in channel.counterparts(&contract, after) {
                budget.spend(PAIR);
                let pair = Pair::new(entity, &contract, other);
                if matches
                    && sessions.may_link(other.node)
                    && !self.registry.links().joins(pair)
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
                Some(node) => self.registry.mark_unlinked(pair, self.quota(node)),
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
            let is_there = self.registry.sessions().are_there(pair);
            match self.node_without_room(pair) {
                _ if self.registry.links().joins(pair) || !is_there => {}
                Some(node) => self.registry.mark_unlinked(pair, self.quota(node)),
                None => {
                    let links = self.link(pair.offering, pair.demanding);
                    self.outbox.extend(links);
                }
            }
        }
    }

    /// A node of this pair whose quota has no room for one more link.
    fn node_without_room(&self, pair: Pair) -> Option<NodeId> {
        let limit = self.limits.links_per_session();
        self.registry.sessions().node_without_room(pair, limit)
    }

    /// Makes a link between a pair. Returns its LINKs unless they have to wait.
    //= SM2-LNK-001, SM2-LNK-002, SM2-MAT-002, SM2-MAT-003, SM2-VER-002
    fn link(&mut self, one: EntityId, other: EntityId) -> Option<Output> {
        let sessions = self.registry.sessions();
        let (us, ours) = sessions.user_and_contract(one)?;
        let (them, theirs) = sessions.user_and_contract(other)?;
        let qos = match_contracts(ours, theirs).ok()?;
        let pair = Pair::new(one, ours, other);
        let agreed = Agreed {
            version: VERSION,
            qos: LinkQos {
                sealed: qos.sealed || self.limits.seals(us == them),
                ..qos
            },
        };
        let waits = self.registry.must_wait(pair);
        let (link, key) = self.registry.number_link();
        self.insert_link(link, pair, agreed, !waits);
        if waits {
            self.registry.pending_links.insert(pair, link);
            return None;
        }
        self.announcement((link, key), [one, other], agreed)
    }

    /// The two LINKs of a live link.
    //= SM2-LNK-001, SM2-LNK-002, SM2-LNK-006
    fn announcement(
        &self,
        (link, key): (LinkId, LinkKey),
        [one, other]: [EntityId; 2],
        agreed: Agreed,
    ) -> Option<Output> {
        let sessions = self.registry.sessions();
        let (ours, theirs) = (sessions.peer(one)?, sessions.peer(other)?);
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
        self.registry.insert_link(link, pair, agreed, announced);
        self.shortage.remove(pair);
    }

    /// Announces the pending links of a session after this one, as far as both ends have room and
    /// the budget of one part allows.
    //= SM2-LNK-006, SM2-SES-009
    pub(super) fn announce_pending(&mut self, node: NodeId, mut after: LinkId) {
        let mut budget = Budget::new(&self.limits);
        while !self.registry.holds_back(node, 1)
            && let Some(link) = self.registry.pending_links.next_of(node, after)
        {
            if budget.is_spent() {
                return self.registry.pending_links.go_on(node, after);
            }
            after = link;
            budget.spend(PAIR);
            if let Some((pair, agreed)) = self.registry.announce(link) {
                budget.spend(LINK);
                let key = self.registry.links().key(link);
                let links = self.announcement((link, key), pair.entities(), agreed);
                self.outbox.extend(links);
            }
        }
    }
}
