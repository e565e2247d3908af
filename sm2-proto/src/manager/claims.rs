//! Links of earlier Managers: nodes that come back claim them, and a link that both of
//! its ends have claimed is adopted (SPEC section 11).

#[cfg(any(kani, test))]
mod proofs;

use alloc::{
    collections::{BTreeMap, BTreeSet},
    vec::Vec,
};
use core::ops::Bound;

use super::{
    Cause, Manager,
    links::{Agreed, Pair},
    session::Session,
};
use crate::{
    Code, EntityId, Farewell, Instant, LinkId, NodeId, VERSION, Violation,
    control::{Item, Key, ToNode},
    match_contracts,
};

/// What two ends have to say alike of their link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Claim {
    pub(super) key: u64,
    pub(super) agreed: Agreed,
}

/// The claims without a counterpart.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Claims {
    half: BTreeMap<(LinkId, EntityId), Claim>,
    /// The same, by what a counterpart has to say.
    waiting: BTreeMap<(LinkId, Claim), EntityId>,
    /// When those of a session that has claimed all it has are given up.
    expiring: BTreeSet<(Instant, NodeId)>,
}

impl Manager {
    //= SM2-RES-003, SM2-RES-004, SM2-RES-008
    pub(super) fn claim(
        &mut self,
        entity: EntityId,
        link: LinkId,
        claim: Claim,
    ) -> Result<(), Violation> {
        let EntityId { node, interface } = entity;
        let limit = self.policy.links_per_session();
        let Some(session) = self.sessions.get_mut(&node) else {
            return Ok(());
        };
        let record = session.node();
        let known = record.and_then(|it| it.has_link(interface, link));
        let known = known.ok_or(violation!(UnknownInterface, "SM2-RES-003"))?;
        if known || link.epoch == self.links.epoch() || claim.agreed.version != VERSION {
            return Err(violation!(BadClaim, "SM2-RES-003"));
        }
        if !session.may_claim() {
            self.end_session(node, Cause::Farewell(Farewell::Resources));
            return Ok(());
        }
        let record = session.node_mut();
        let record = record.ok_or(violation!(UnknownInterface, "SM2-RES-003"))?;
        record.claim(interface, link);
        if record.link_ends() > limit {
            self.tell(entity, link, Farewell::Resources.code());
            return Ok(());
        }
        match self.claims.meet(link, entity, claim) {
            None => self.changed(Key::Claim { link, entity }),
            Some(other) => {
                self.changed(Key::Claim {
                    link,
                    entity: other,
                });
                self.adopt(link, [entity, other], claim.agreed);
            }
        }
        Ok(())
    }

    /// Both ends have claimed a link.
    //= SM2-RES-004, SM2-RES-005
    fn adopt(&mut self, link: LinkId, ends: [EntityId; 2], agreed: Agreed) {
        match self.adoptable(ends, agreed) {
            Some(pair) => self.record(link, pair, agreed, 0),
            None => {
                for end in ends {
                    self.tell(end, link, Farewell::NotAdopted.code());
                }
            }
        }
    }

    /// Whether this Manager would have made such a link, now.
    //= SM2-RES-005, SM2-MAT-003
    fn adoptable(&self, [one, other]: [EntityId; 2], agreed: Agreed) -> Option<Pair> {
        let (uid, ours) = self.whose(one)?;
        let (their_uid, theirs) = self.whose(other)?;
        let qos = match_contracts(ours, theirs).ok()?;
        let pair = Pair::new(one, ours, other);
        let sealed = qos.sealed || self.policy.seals(uid == their_uid);
        let fits = agreed.qos.reliable == qos.reliable && (agreed.qos.sealed || !sealed);
        (fits && !self.links.joins(pair)).then_some(pair)
    }

    /// The session has claimed all that it has: now it is linked like any other.
    //= SM2-RES-006, SM2-RES-007, SM2-SES-004
    pub(super) fn claimed(&mut self, now: Instant, node: NodeId) {
        let Some(session) = self.sessions.remove(&node) else {
            return;
        };
        let record = session.node();
        let has_half = record.is_some_and(|it| it.half_claims().next().is_some());
        let until = has_half.then(|| now.after(self.policy.recovery));
        self.sessions.insert(node, session.claimed(until));
        if let Some(until) = until {
            self.claims.expiring.insert((until, node));
        }
        self.greeting.remove(&node);
        self.node_changed(node);
        self.settle(node);
    }

    /// Gives up claims whose counterparts did not come.
    //= SM2-RES-006
    pub(super) fn expire_claims(&mut self, now: Instant) {
        while let Some(&(until, node)) = self.claims.expiring.first()
            && until <= now
        {
            self.claims.expiring.pop_first();
            let Some(session) = self.sessions.get_mut(&node) else {
                continue;
            };
            session.claims_expired();
            let half = session
                .node()
                .map(|it| it.half_claims().collect::<Vec<_>>());
            for (interface, link) in half.unwrap_or_default() {
                let entity = EntityId { node, interface };
                self.give_up_claim(entity, link);
                self.tell(entity, link, Farewell::PeerGone.code());
            }
        }
    }

    /// A claim is over, without a word to anybody.
    pub(super) fn give_up_claim(&mut self, entity: EntityId, link: LinkId) {
        if self.claims.remove(link, entity) {
            self.changed(Key::Claim { link, entity });
        }
    }

    /// The Manager says its farewell to a live end of a link.
    pub(super) fn tell(
        &mut self,
        EntityId { node, interface }: EntityId,
        link: LinkId,
        code: Code,
    ) {
        let record = self.sessions.get_mut(&node).and_then(Session::node_mut);
        if let Some(record) = record {
            record.tell(interface, link);
            self.send(
                node,
                &ToNode::Unlink {
                    interface,
                    link,
                    code,
                },
            );
        }
    }
}

impl Claims {
    pub(super) const fn new() -> Self {
        Self {
            half: BTreeMap::new(),
            waiting: BTreeMap::new(),
            expiring: BTreeSet::new(),
        }
    }

    /// The end that claimed the same, which waits no more; none: this one waits now.
    //= SM2-RES-004
    fn meet(&mut self, link: LinkId, entity: EntityId, claim: Claim) -> Option<EntityId> {
        if let Some(other) = self.waiting.remove(&(link, claim)) {
            self.half.remove(&(link, other));
            return Some(other);
        }
        self.waiting.insert((link, claim), entity);
        self.half.insert((link, entity), claim);
        None
    }

    /// Whether it was there.
    fn remove(&mut self, link: LinkId, entity: EntityId) -> bool {
        let Some(claim) = self.half.remove(&(link, entity)) else {
            return false;
        };
        self.waiting.remove(&(link, claim)).is_some()
    }

    /// A session is over that had claims to give up at some time.
    pub(super) fn forget(&mut self, until: Instant, node: NodeId) {
        self.expiring.remove(&(until, node));
    }

    pub(super) fn deadline(&self) -> Option<Instant> {
        let &(deadline, _) = self.expiring.first()?;
        Some(deadline)
    }

    pub(super) fn item(&self, link: LinkId, entity: EntityId) -> Option<Item> {
        let there = self.half.contains_key(&(link, entity));
        there.then_some(Item::Claim { link, entity })
    }

    /// In the order of their keys.
    pub(super) fn items(&self, after: (LinkId, EntityId)) -> impl Iterator<Item = Item> {
        let rest = (Bound::Excluded(after), Bound::Unbounded);
        let rest = self.half.range(rest);
        rest.map(|(&(link, entity), _)| Item::Claim { link, entity })
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = (LinkId, EntityId)> {
        self.half.keys().copied()
    }

    pub(super) fn expiring(&self) -> impl Iterator<Item = (Instant, NodeId)> {
        self.expiring.iter().copied()
    }

    /// Whether the tables say the same.
    pub(super) fn agree(&self) -> bool {
        let waits = |(&(link, entity), &claim): (&(LinkId, EntityId), &Claim)| {
            self.waiting.get(&(link, claim)) == Some(&entity)
        };
        self.waiting.len() == self.half.len() && self.half.iter().all(waits)
    }
}
