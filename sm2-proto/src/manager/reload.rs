//! The progress of an access policy that is being applied to a domain that runs (SM2-ACC-014).

use alloc::collections::{BTreeMap, BTreeSet, btree_map::Entry};

use crate::{EntityId, Farewell, Instant, LinkId, NodeId, Violation};

/// An answer that a node owes: UNLINKED for a link of the interface, or SUSPENDED for the interface.
type Asked = (EntityId, Option<LinkId>);

/// The progress of a policy that is being applied.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Reload {
    pub(super) pass: Option<Pass>,
    /// The answers that nodes owe, and how many of each.
    unconfirmed: BTreeMap<Asked, u32>,
    /// The sessions under names that the policy denies. They end when their links have.
    pub(super) denied: BTreeSet<NodeId>,
    /// The latest time for all nodes to confirm, once both passes are over.
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
            unconfirmed: BTreeMap::new(),
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

    /// A node was told UNLINK `denied` for a link of an interface, or that the interface is suspended.
    pub(super) fn ask(&mut self, entity: EntityId, link: Option<LinkId>) {
        let owed = self.unconfirmed.entry((entity, link)).or_default();
        *owed = owed.saturating_add(1);
    }

    /// A node has answered. Returns whether it owed this answer.
    pub(super) fn confirm(&mut self, entity: EntityId, link: Option<LinkId>) -> bool {
        let Entry::Occupied(mut owed) = self.unconfirmed.entry((entity, link)) else {
            return false;
        };
        *owed.get_mut() -= 1;
        if *owed.get() == 0 {
            owed.remove();
        }
        true
    }

    /// SUSPENDED.
    //= SM2-ACC-014
    pub(super) fn suspended(&mut self, entity: EntityId) -> Result<(), Violation> {
        match self.confirm(entity, None) {
            true => Ok(()),
            false => Err(violation!(UnexpectedSuspended, "SM2-ACC-014")),
        }
    }

    /// The interface is withdrawn.
    pub(super) fn forget_interface(&mut self, entity: EntityId) {
        while let Some(asked) = self.asked_from(entity).filter(|asked| asked.0 == entity) {
            self.unconfirmed.remove(&asked);
        }
    }

    /// The session is over.
    pub(super) fn forget_session(&mut self, node: NodeId) {
        self.denied.remove(&node);
        while let Some(asked) = self.asked_of(node) {
            self.unconfirmed.remove(&asked);
        }
    }

    fn asked_from(&self, entity: EntityId) -> Option<Asked> {
        let mut rest = self.unconfirmed.range((entity, None)..);
        rest.next().map(|(&asked, _)| asked)
    }

    fn asked_of(&self, node: NodeId) -> Option<Asked> {
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
        let (&(entity, _), _) = self
            .unconfirmed
            .first_key_value()
            .filter(|_| until <= now)?;
        Some((entity.node, Farewell::Stalled))
    }

    /// The time when the nodes that have not confirmed are given up.
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
