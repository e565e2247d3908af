//! The items that a session may see (SM2-ACC-010).

use alloc::sync::Arc;

use super::{Manager, session::Session};
use crate::{EntityId, NodeId, control::Item, policy::AccessPolicy};

impl Manager {
    /// Whether a session may see an item: its own ones always.
    //= SM2-ACC-010
    pub(super) fn sees(&self, viewer: NodeId, item: &Item) -> bool {
        if !self.access.is_restricted() {
            return true;
        }
        match item {
            Item::Domain { .. } => true,
            Item::Node { node, name, .. } => {
                *node == viewer || self.access.allows_sight(viewer, name, None)
            }
            Item::Interface { entity, contract }
            | Item::Refusal {
                entity, contract, ..
            } => {
                let owner = self.access.owner(entity.node);
                entity.node == viewer
                    || owner.is_some_and(|it| {
                        let name = Some(contract.name());
                        self.access.allows_sight(viewer, it, name)
                    })
            }
            Item::Claim { entity, .. } => self.sees_interface(viewer, *entity),
            Item::Link {
                offering,
                demanding,
                ..
            }
            | Item::Waiting {
                offering,
                demanding,
                ..
            }
            | Item::Unlinked {
                offering,
                demanding,
                ..
            } => self.sees_interface(viewer, *offering) && self.sees_interface(viewer, *demanding),
        }
    }

    fn sees_interface(&self, viewer: NodeId, entity: EntityId) -> bool {
        if entity.node == viewer {
            return true;
        }
        if let Some((owner, name)) = self.access.ending(entity) {
            return self.access.allows_sight(viewer, owner, Some(name));
        }
        let record = self.sessions.get(&entity.node).and_then(Session::node);
        record.is_some_and(|it| {
            let contract = it.contract(entity.interface);
            contract.is_some_and(|contract| {
                let name = Some(contract.name());
                self.access.allows_sight(viewer, it.name(), name)
            })
        })
    }

    /// Whether a policy restricts the domain.
    #[must_use]
    pub const fn has_access_policy(&self) -> bool {
        self.access.is_restricted()
    }

    /// Sets the access policy of the domain. Without this call everything is allowed. To be called
    /// before the first input; later, [`Input::SetAccessPolicy`] sets another one.
    ///
    /// [`Input::SetAccessPolicy`]: super::Input::SetAccessPolicy
    #[must_use]
    pub fn with_access_policy(mut self, policy: AccessPolicy) -> Self {
        self.access.set_policy(Some(Arc::new(policy)));
        self
    }
}
