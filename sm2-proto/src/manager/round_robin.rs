//! A queue of sessions that are served in turn.

use alloc::collections::BTreeSet;
use core::ops::Bound;

use crate::NodeId;

/// The sessions that wait to be served, each at most once.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct RoundRobin {
    waiting: BTreeSet<NodeId>,
    /// The session that was served last; number 0 if none waits. So machines that differ only in
    /// their past are equal.
    last: NodeId,
}

impl RoundRobin {
    pub(super) const fn new() -> Self {
        Self {
            waiting: BTreeSet::new(),
            last: NodeId(0),
        }
    }

    pub(super) fn insert(&mut self, node: NodeId) {
        self.waiting.insert(node);
    }

    pub(super) fn remove(&mut self, node: NodeId) {
        self.waiting.remove(&node);
        if self.waiting.is_empty() {
            self.last = NodeId(0);
        }
    }

    pub(super) fn contains(&self, node: NodeId) -> bool {
        self.waiting.contains(&node)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// All sessions that wait, in ascending order.
    pub(super) fn iter(&self) -> impl Iterator<Item = NodeId> {
        self.waiting.iter().copied()
    }

    /// Removes the first session after the one that was served last, or the first of all if
    /// there is none after it.
    pub(super) fn next(&mut self) -> Option<NodeId> {
        let later = (Bound::Excluded(self.last), Bound::Unbounded);
        let next = self.waiting.range(later).next().copied();
        let next = next.or_else(|| self.waiting.first().copied())?;
        self.last = next;
        self.remove(next);
        Some(next)
    }
}
