//! The links of interfaces that are gone, as far as they have not been ended at the other side.

use alloc::collections::BTreeMap;

use super::links::Pair;
use crate::{EntityId, Farewell, LinkId, NodeId};

/// By interface. An entry without links stays until the interface's unlinked pairs are forgotten.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct EndingLinks(BTreeMap<EntityId, Ending>);

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Ending {
    cause: Farewell,
    links: BTreeMap<LinkId, Option<Pair>>,
}

impl EndingLinks {
    pub(super) const fn new() -> Self {
        Self(BTreeMap::new())
    }

    pub(super) fn insert(
        &mut self,
        entity: EntityId,
        cause: Farewell,
        links: BTreeMap<LinkId, Option<Pair>>,
    ) {
        self.0.insert(entity, Ending { cause, links });
    }

    /// Whether a session has links to be ended.
    pub(super) fn has(&self, node: NodeId) -> bool {
        self.first_of(node).is_some()
    }

    /// The first interface of a session, and the reason why it is gone.
    pub(super) fn first_of(&self, node: NodeId) -> Option<(EntityId, Farewell)> {
        let (&entity, ending) = self.0.range(EntityId::node(node)..).next()?;
        (entity.node == node).then_some((entity, ending.cause))
    }

    /// Takes out the oldest link of an interface.
    pub(super) fn pop(&mut self, entity: EntityId) -> Option<(LinkId, Option<Pair>)> {
        self.0.get_mut(&entity)?.links.pop_first()
    }

    /// Removes a link that the other side has ended.
    pub(super) fn forget(&mut self, entity: EntityId, link: LinkId) {
        if let Some(ending) = self.0.get_mut(&entity) {
            ending.links.remove(&link);
        }
    }

    pub(super) fn remove(&mut self, entity: EntityId) {
        self.0.remove(&entity);
    }

    pub(super) fn has_interface(&self, entity: EntityId) -> bool {
        self.0.contains_key(&entity)
    }

    /// The pair of a link that is still to be ended, as
    /// [`NodeRecord::live_link`](super::node_record::NodeRecord::live_link) states it.
    pub(super) fn link(&self, entity: EntityId, link: LinkId) -> Option<Option<Pair>> {
        self.0.get(&entity)?.links.get(&link).copied()
    }

    /// The pairs of all links.
    pub(super) fn pairs(&self) -> impl Iterator<Item = Option<Pair>> {
        self.0.values().flat_map(|it| it.links.values().copied())
    }

    /// The session of each interface.
    pub(super) fn nodes(&self) -> impl Iterator<Item = NodeId> {
        self.0.keys().map(|it| it.node)
    }
}
