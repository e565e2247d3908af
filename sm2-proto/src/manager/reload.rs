//! The progress of an access policy that is being applied to a domain that runs (SM2-ACC-014).

use alloc::collections::BTreeSet;

use crate::{EntityId, Farewell, Instant, LinkId, NodeId};

/// The progress of a policy that is being applied.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Reload {
    pub(super) pass: Option<Pass>,
    /// The ends of links that were told UNLINK `denied` and have not answered.
    unconfirmed: BTreeSet<(EntityId, LinkId)>,
    /// The sessions under names that the policy denies. They end when their links have.
    pub(super) denied: BTreeSet<NodeId>,
    /// The time by which all nodes have to confirm, once both passes are over.
    pub(super) until: Option<Instant>,
}

/// Where the next part of the work begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Pass {
    /// With this node or interface.
    Deny(EntityId),
    /// With this interface, or with its counterparts after one if its suspension has ended.
    Allow(EntityId, Option<EntityId>),
}

impl Reload {
    pub(super) const fn new() -> Self {
        Self {
            pass: None,
            unconfirmed: BTreeSet::new(),
            denied: BTreeSet::new(),
            until: None,
        }
    }

    /// Both passes begin.
    pub(super) fn begin(&mut self) {
        self.pass = Some(Pass::Deny(EntityId::FIRST));
        self.denied.clear();
        self.until = None;
    }

    /// An end of a link was told UNLINK `denied`.
    pub(super) fn ask(&mut self, entity: EntityId, link: LinkId) {
        self.unconfirmed.insert((entity, link));
    }

    /// An end of a link is over.
    pub(super) fn confirm(&mut self, entity: EntityId, link: LinkId) {
        self.unconfirmed.remove(&(entity, link));
    }

    /// The interface is withdrawn.
    pub(super) fn forget_interface(&mut self, entity: EntityId) {
        while let Some(end) = self.asked_from(entity).filter(|end| end.0 == entity) {
            self.unconfirmed.remove(&end);
        }
    }

    /// The session is over.
    pub(super) fn forget_session(&mut self, node: NodeId) {
        self.denied.remove(&node);
        while let Some(end) = self.asked_of(node) {
            self.unconfirmed.remove(&end);
        }
    }

    fn asked_from(&self, entity: EntityId) -> Option<(EntityId, LinkId)> {
        let mut rest = self.unconfirmed.range((entity, LinkId::FIRST)..);
        rest.next().copied()
    }

    fn asked_of(&self, node: NodeId) -> Option<(EntityId, LinkId)> {
        let first = self.asked_from(EntityId::node(node));
        first.filter(|(entity, _)| entity.node == node)
    }

    /// The session that ends next, and why: its name is denied and its links have ended, or it has
    /// not confirmed in time. A session that `waits` for the policy ends after its answer.
    pub(super) fn next_end(
        &self,
        now: Instant,
        waits: impl Fn(NodeId) -> bool,
    ) -> Option<(NodeId, Farewell)> {
        let until = self.until?;
        let mut denied = self.denied.iter().copied();
        if let Some(node) = denied.find(|&it| !waits(it) && self.asked_of(it).is_none()) {
            return Some((node, Farewell::Denied));
        }
        let (entity, _) = self.unconfirmed.first().filter(|_| until <= now)?;
        Some((entity.node, Farewell::Stalled))
    }

    /// The time at which the nodes that have not confirmed are given up.
    pub(super) fn deadline(&self) -> Option<Instant> {
        self.until.filter(|_| !self.unconfirmed.is_empty())
    }

    /// Whether some work can be done now.
    pub(super) fn is_due(&self, now: Instant, waits: impl Fn(NodeId) -> bool) -> bool {
        self.pass.is_some() || self.next_end(now, waits).is_some()
    }

    /// Whether the policy is applied, but for the ends of sessions that `wait` for that.
    pub(super) fn is_confirmed(&self, waits: impl Fn(NodeId) -> bool) -> bool {
        let mut denied = self.denied.iter();
        self.pass.is_none() && self.unconfirmed.is_empty() && denied.all(|&it| waits(it))
    }

    pub(super) fn is_over(&self) -> bool {
        self.is_confirmed(|_| false)
    }
}
