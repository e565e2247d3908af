//! The claims of links from earlier Managers that wait for the claim of the other end.
//!
//! The Manager puts a number into both LINK frames of a link that no other process can guess (SipHash of the serial
//! number under a secret). Two claims with the same key therefore come from the two ends of the link, and a claim of
//! any other process has no counterpart. No process has to remember the keys.
//!
//! A claim waits 5 s for its counterpart. A node that is stopped for longer loses the links that it had during the
//! take-over, and is linked again when it continues. Waiting without a limit would keep the links of stopped nodes for
//! ever, and also those of nodes that closed their end without a frame.

#[cfg(any(kani, test))]
mod proofs;

use alloc::collections::{BTreeMap, BTreeSet};
use core::ops::Bound;

use super::links::Agreed;
use crate::{EntityId, Instant, LinkId, LinkKey, NodeId, control::Item};

/// The values that two claims have to agree on to be the two ends of one link.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Claim {
    pub(super) key: LinkKey,
    pub(super) agreed: Agreed,
}

/// The claims without a counterpart.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Claims {
    half: BTreeMap<(LinkId, EntityId), Claim>,
    /// The same claims, by the values that a counterpart has to name.
    waiting: BTreeMap<(LinkId, Claim), EntityId>,
    /// The times when the claims of sessions expire that have sent CLAIMED.
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

    /// Takes out the claim of another end that agrees with this one. If there is none, this claim
    /// waits from now on.
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

    /// Removes a claim that waits. Returns whether there was one.
    pub(super) fn remove(&mut self, link: LinkId, entity: EntityId) -> bool {
        let Some(claim) = self.half.remove(&(link, entity)) else {
            return false;
        };
        self.waiting.remove(&(link, claim)).is_some()
    }

    /// A session with a time of expiry is over.
    pub(super) fn forget(&mut self, until: Instant, node: NodeId) {
        self.expiring.remove(&(until, node));
    }

    /// The claims of a session expire at `until`.
    pub(super) fn expire_at(&mut self, until: Instant, node: NodeId) {
        self.expiring.insert((until, node));
    }

    /// Takes out a session whose claims have expired.
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

    /// Whether the two tables agree.
    pub(super) fn agree(&self) -> bool {
        let waits = |(&(link, entity), &claim): (&(LinkId, EntityId), &Claim)| {
            self.waiting.get(&(link, claim)) == Some(&entity)
        };
        self.waiting.len() == self.half.len() && self.half.iter().all(waits)
    }
}
