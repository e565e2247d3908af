//! The claims of links from earlier Managers that wait for the claim of the other end.

#[cfg(any(kani, test))]
mod proofs;

use alloc::collections::{BTreeMap, BTreeSet};
use core::ops::Bound;

use super::links::Agreed;
use crate::{EntityId, Instant, LinkId, LinkKey, NodeId, control::Item};

/// What two ends have to say alike of their link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Claim {
    pub(super) key: LinkKey,
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
    pub(super) fn meet(
        &mut self,
        link: LinkId,
        entity: EntityId,
        claim: Claim,
    ) -> Option<EntityId> {
        if let Some(other) = self.waiting.remove(&(link, claim)) {
            self.half.remove(&(link, other));
            return Some(other);
        }
        self.waiting.insert((link, claim), entity);
        self.half.insert((link, entity), claim);
        None
    }

    /// Whether it was there.
    pub(super) fn remove(&mut self, link: LinkId, entity: EntityId) -> bool {
        let Some(claim) = self.half.remove(&(link, entity)) else {
            return false;
        };
        self.waiting.remove(&(link, claim)).is_some()
    }

    /// A session is over that had claims to give up at some time.
    pub(super) fn forget(&mut self, until: Instant, node: NodeId) {
        self.expiring.remove(&(until, node));
    }

    /// The claims of a session are given up at `until`.
    pub(super) fn expire_at(&mut self, until: Instant, node: NodeId) {
        self.expiring.insert((until, node));
    }

    /// A session whose claims are to be given up by now.
    pub(super) fn pop_expired(&mut self, now: Instant) -> Option<NodeId> {
        let &(until, node) = self.expiring.first()?;
        if until > now {
            return None;
        }
        self.expiring.pop_first();
        Some(node)
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
