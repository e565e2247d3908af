//! The sessions that have the access policy read again (SM2-ACC-016).

use alloc::collections::BTreeSet;
use core::mem;

use crate::NodeId;

/// The user that may ask, and the sessions whose RELOAD is not answered.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct ReloadRequests {
    /// The user of the Manager's process, who may have the policy read again.
    pub(super) owner: Option<u32>,
    /// Those whose policy is not read yet.
    reading: BTreeSet<NodeId>,
    /// Those whose policy is read, and not applied yet.
    applying: BTreeSet<NodeId>,
}

impl ReloadRequests {
    pub(super) const fn new() -> Self {
        Self {
            owner: None,
            reading: BTreeSet::new(),
            applying: BTreeSet::new(),
        }
    }

    /// A session asks.
    pub(super) fn insert(&mut self, node: NodeId) {
        self.reading.insert(node);
    }

    /// Whether the session waits for an answer.
    pub(super) fn waits(&self, node: NodeId) -> bool {
        self.reading.contains(&node) || self.is_applying(node)
    }

    /// The policy is read: all sessions that asked wait until it is applied.
    pub(super) fn begin_applying(&mut self) {
        self.applying.append(&mut self.reading);
    }

    /// Takes the sessions whose policy is not read yet.
    pub(super) fn take_reading(&mut self) -> BTreeSet<NodeId> {
        mem::take(&mut self.reading)
    }

    /// Takes the sessions whose policy is read.
    pub(super) fn take_applying(&mut self) -> BTreeSet<NodeId> {
        mem::take(&mut self.applying)
    }

    /// The session is over.
    pub(super) fn forget(&mut self, node: NodeId) {
        self.reading.remove(&node);
        self.applying.remove(&node);
    }

    /// Whether the session waits until the policy is applied.
    pub(super) fn is_applying(&self, node: NodeId) -> bool {
        self.applying.contains(&node)
    }

    /// The sessions that wait for an answer.
    pub(super) fn sessions(&self) -> impl Iterator<Item = NodeId> {
        self.reading.union(&self.applying).copied()
    }
}
