//! The progress of an access policy that is being applied to a domain that runs (SM2-ACC-017).

use alloc::collections::{BTreeMap, BTreeSet};

use crate::{EntityId, Farewell, Instant, LinkId, NodeId, Violation};

/// The progress of a policy that is being applied.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Reload {
    pub(super) pass: Option<Pass>,
    /// The ends of links that were told UNLINK `denied` and have not answered.
    unconfirmed: BTreeSet<(EntityId, LinkId)>,
    /// The interfaces whose nodes were told that they are suspended, and how many SUSPENDED are to
    /// come.
    suspensions: BTreeMap<EntityId, u32>,
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
            suspensions: BTreeMap::new(),
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

    /// A node was told that an interface of it is suspended.
    pub(super) fn suspend(&mut self, entity: EntityId) {
        let unanswered = self.suspensions.entry(entity).or_default();
        *unanswered = unanswered.saturating_add(1);
    }

    /// SUSPENDED.
    //= SM2-ACC-017
    pub(super) fn suspended(&mut self, entity: EntityId) -> Result<(), Violation> {
        let unexpected = violation!(UnexpectedSuspended, "SM2-ACC-017");
        let unanswered = self.suspensions.get_mut(&entity).ok_or(unexpected)?;
        *unanswered -= 1;
        if *unanswered == 0 {
            self.suspensions.remove(&entity);
        }
        Ok(())
    }

    /// The interface is withdrawn.
    pub(super) fn forget_interface(&mut self, entity: EntityId) {
        self.suspensions.remove(&entity);
        while let Some(end) = self.asked_from(entity).filter(|end| end.0 == entity) {
            self.unconfirmed.remove(&end);
        }
    }

    /// The session is over.
    pub(super) fn forget_session(&mut self, node: NodeId) {
        self.denied.remove(&node);
        while let Some(entity) = self.suspension_of(node) {
            self.suspensions.remove(&entity);
        }
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

    fn suspension_of(&self, node: NodeId) -> Option<EntityId> {
        let mut rest = self.suspensions.range(EntityId::node(node)..);
        rest.next().map(|(&it, _)| it).filter(|it| it.node == node)
    }

    /// Whether the session has answered all that it was told.
    fn has_confirmed(&self, node: NodeId) -> bool {
        self.asked_of(node).is_none() && self.suspension_of(node).is_none()
    }

    /// The first session that has not.
    fn first_unconfirmed(&self) -> Option<NodeId> {
        let link = self.unconfirmed.first().map(|(entity, _)| entity.node);
        link.or_else(|| Some(self.suspensions.first_key_value()?.0.node))
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
        if let Some(node) = denied.find(|&it| !waits(it) && self.has_confirmed(it)) {
            return Some((node, Farewell::Denied));
        }
        let node = self.first_unconfirmed().filter(|_| until <= now)?;
        Some((node, Farewell::Stalled))
    }

    /// The time at which the nodes that have not confirmed are given up.
    pub(super) fn deadline(&self) -> Option<Instant> {
        self.until.filter(|_| self.first_unconfirmed().is_some())
    }

    /// Whether some work can be done now.
    pub(super) fn is_due(&self, now: Instant, waits: impl Fn(NodeId) -> bool) -> bool {
        self.pass.is_some() || self.next_end(now, waits).is_some()
    }

    /// Whether the policy is applied, but for the ends of sessions that `wait` for that.
    pub(super) fn is_confirmed(&self, waits: impl Fn(NodeId) -> bool) -> bool {
        let mut denied = self.denied.iter();
        self.pass.is_none() && self.first_unconfirmed().is_none() && denied.all(|&it| waits(it))
    }

    pub(super) fn is_over(&self) -> bool {
        self.is_confirmed(|_| false)
    }
}
