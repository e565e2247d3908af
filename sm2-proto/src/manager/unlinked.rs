//! The pairs that match and are not linked, as far as they are remembered (SM2-WCH-004).

#[cfg(any(kani, test))]
mod proofs;

use alloc::collections::{BTreeMap, BTreeSet};
use core::ops::Bound;

use super::links::Pair;
use crate::{
    EntityId, NodeId,
    control::{Item, UnlinkedReason},
};

/// The reason for each pair.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct UnlinkedPairs {
    reasons: BTreeMap<Pair, UnlinkedReason>,
    /// The same pairs, the demanding side first.
    by_demanding: BTreeSet<(EntityId, EntityId)>,
    /// The number of pairs that each node offers. A node that offers none has no entry.
    offered: BTreeMap<NodeId, usize>,
}

impl UnlinkedPairs {
    pub(super) const fn new() -> Self {
        Self {
            reasons: BTreeMap::new(),
            by_demanding: BTreeSet::new(),
            offered: BTreeMap::new(),
        }
    }

    /// Adds a pair, or gives it another reason. Returns whether the quota has room for it.
    pub(super) fn insert(&mut self, pair: Pair, reason: UnlinkedReason, limit: usize) -> bool {
        if !self.reasons.contains_key(&pair) {
            let offered = self.offered.get(&pair.offering.node).copied();
            let offered = offered.unwrap_or(0) + 1;
            if offered > limit {
                return false;
            }
            self.offered.insert(pair.offering.node, offered);
            self.by_demanding.insert((pair.demanding, pair.offering));
        }
        self.reasons.insert(pair, reason);
        true
    }

    /// Removes a pair. Returns whether it was there.
    pub(super) fn remove(&mut self, pair: Pair) -> bool {
        if self.reasons.remove(&pair).is_none() {
            return false;
        }
        self.by_demanding.remove(&(pair.demanding, pair.offering));
        let node = pair.offering.node;
        match self.offered.get_mut(&node) {
            Some(offered) if *offered > 1 => *offered -= 1,
            _ => drop(self.offered.remove(&node)),
        }
        true
    }

    /// The first pair of an interface.
    pub(super) fn first_of(&self, entity: EntityId) -> Option<Pair> {
        self.of(entity).next()
    }

    /// All pairs of an interface.
    fn of(&self, entity: EntityId) -> impl Iterator<Item = Pair> {
        let offering = self.reasons.range(pair(entity, EntityId::FIRST)..);
        let offering = offering.map(|(&pair, _)| pair);
        let demanding = self.by_demanding.range((entity, EntityId::FIRST)..);
        let demanding = demanding.map(|&(demanding, offering)| pair(offering, demanding));
        offering
            .take_while(move |pair| pair.offering == entity)
            .chain(demanding.take_while(move |pair| pair.demanding == entity))
    }

    pub(super) fn item(&self, pair: Pair) -> Option<Item> {
        let &reason = self.reasons.get(&pair)?;
        Some(item(pair, reason))
    }

    /// In the order of their keys.
    pub(super) fn items(
        &self,
        (offering, demanding): (EntityId, EntityId),
    ) -> impl Iterator<Item = Item> {
        let after = Bound::Excluded(pair(offering, demanding));
        let rest = self.reasons.range((after, Bound::Unbounded));
        rest.map(|(&pair, &reason)| item(pair, reason))
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = Pair> {
        self.reasons.keys().copied()
    }

    /// Whether the tables agree, and no node offers more than its quota.
    pub(super) fn agree(&self, limit: usize) -> bool {
        let mut recount = BTreeMap::new();
        for pair in self.iter() {
            *recount.entry(pair.offering.node).or_insert(0) += 1;
        }
        let listed = |pair: Pair| self.by_demanding.contains(&(pair.demanding, pair.offering));
        recount == self.offered
            && recount.values().all(|&offered| offered <= limit)
            && self.by_demanding.len() == self.reasons.len()
            && self.iter().all(listed)
    }
}

const fn pair(offering: EntityId, demanding: EntityId) -> Pair {
    Pair {
        offering,
        demanding,
    }
}

const fn item(pair: Pair, reason: UnlinkedReason) -> Item {
    Item::Unlinked {
        offering: pair.offering,
        demanding: pair.demanding,
        reason,
    }
}
