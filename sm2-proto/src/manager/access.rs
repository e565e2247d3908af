//! The access rights of the sessions: SPEC section 15.

use alloc::{collections::BTreeMap, sync::Arc, vec::Vec};

use super::{Credentials, sessions::Sessions};
use crate::{
    Contract, EntityId, Kind, Name, NodeId, Refusal,
    control::Item,
    policy::{AccessPolicy, Action, Decision, Effect, Subject, User},
};

/// The policy, and the subjects that it decides about.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Access {
    /// `None`: everything is allowed.
    policy: Option<Arc<AccessPolicy>>,
    /// The further groups of connections, until they are welcomed.
    groups: BTreeMap<NodeId, Vec<u32>>,
    /// The welcomed sessions.
    subjects: BTreeMap<NodeId, Subject>,
    /// The names of the node and of the topic or service of each interface that is gone and whose
    /// links have not all ended yet.
    ending: BTreeMap<EntityId, (Name, Name)>,
}

impl Access {
    pub(super) const fn new() -> Self {
        Self {
            policy: None,
            groups: BTreeMap::new(),
            subjects: BTreeMap::new(),
            ending: BTreeMap::new(),
        }
    }

    /// Sets the policy. Returns whether it differs from the one before.
    pub(super) fn set_policy(&mut self, policy: Option<Arc<AccessPolicy>>) -> bool {
        let differs = self.policy != policy;
        self.policy = policy;
        differs
    }

    /// Notes the groups of a connection beside the group of its credentials. Also without a policy:
    /// the domain may get one.
    pub(super) fn add_groups(&mut self, node: NodeId, gids: &[u32]) {
        if !self.subjects.contains_key(&node) {
            self.groups.insert(node, gids.to_vec());
        }
    }

    fn user(&self, node: NodeId, credentials: Credentials) -> User {
        let mut gids = self.groups.get(&node).cloned().unwrap_or_default();
        gids.push(credentials.gid);
        User {
            uid: credentials.uid,
            gids,
        }
    }

    /// Refuses the name of a node that a binding keeps from the user.
    //= SM2-ACC-008
    pub(super) fn refuse_name(
        &self,
        node: NodeId,
        credentials: Credentials,
        name: &Name,
    ) -> Result<(), Refusal> {
        match &self.policy {
            None => Ok(()),
            Some(policy) => refuse_binding(policy, &self.user(node, credentials), name),
        }
    }

    /// Refuses the name of a welcomed node.
    //= SM2-ACC-013
    pub(super) fn refuse_welcomed(&self, node: NodeId) -> Result<(), Refusal> {
        match (&self.policy, self.subjects.get(&node)) {
            (Some(policy), Some(it)) => refuse_binding(policy, it.user(), it.node()),
            _ => Ok(()),
        }
    }

    pub(super) fn welcome(&mut self, node: NodeId, credentials: Credentials, name: &Name) {
        let user = self.user(node, credentials);
        self.groups.remove(&node);
        self.subjects.insert(node, Subject::new(user, name.clone()));
    }

    pub(super) fn end(&mut self, node: NodeId) {
        self.groups.remove(&node);
        self.subjects.remove(&node);
    }

    /// Refuses an interface that the session may not declare. `publishers` counts those of the topic.
    //= SM2-ACC-009
    pub(super) fn refuse_interface(
        &self,
        node: NodeId,
        contract: &Contract,
        publishers: usize,
    ) -> Result<(), Refusal> {
        let Some(policy) = &self.policy else {
            return Ok(());
        };
        // A reload may have denied the name of the node.
        self.refuse_welcomed(node)?;
        let action = match contract.kind() {
            Kind::Publisher => Action::Publish,
            Kind::Subscriber => Action::Subscribe,
            Kind::Server => Action::Serve,
            Kind::Client => Action::Call,
        };
        let decision = self.decide(node, action, contract.name());
        if let Some(Decision { effect, rule }) = decision
            && effect == Effect::Deny
        {
            let rule = rule.and_then(|it| policy.rule_name(it)).cloned();
            return Err(Refusal::Denied { rule });
        }
        match policy.exclusive(contract.name()) {
            Some(entry) if action == Action::Publish && publishers > 0 => Err(Refusal::Exclusive {
                rule: entry.name.clone(),
            }),
            _ => Ok(()),
        }
    }

    fn decide(&self, node: NodeId, action: Action, name: &Name) -> Option<Decision> {
        let policy = self.policy.as_ref()?;
        Some(policy.decide(self.subjects.get(&node)?, action, name))
    }

    fn allows(&self, node: NodeId, action: Action, name: &Name) -> bool {
        let decision = self.decide(node, action, name);
        decision.is_none_or(|it| it.effect == Effect::Allow)
    }

    /// Whether a session may read the counters of another one.
    //= SM2-ACC-011
    pub(super) fn allows_inspection(&self, node: NodeId, of: NodeId) -> bool {
        let subject = self.subjects.get(&of);
        node == of || subject.is_none_or(|it| self.allows(node, Action::ReadCounters, it.node()))
    }

    /// Whether a session may see an item: its own ones always.
    //= SM2-ACC-010
    pub(super) fn sees(&self, viewer: NodeId, item: &Item, sessions: &Sessions) -> bool {
        if !self.is_restricted() {
            return true;
        }
        match item {
            Item::Domain { .. } => true,
            Item::Node { node, name, .. } => {
                *node == viewer || self.allows_sight(viewer, name, None)
            }
            Item::Interface { entity, contract }
            | Item::Refusal {
                entity, contract, ..
            } => {
                let owner = self.subjects.get(&entity.node).map(Subject::node);
                entity.node == viewer
                    || owner.is_some_and(|it| self.allows_sight(viewer, it, Some(contract.name())))
            }
            Item::Claim { entity, .. } => self.sees_interface(viewer, *entity, sessions),
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
            } => [offering, demanding]
                .into_iter()
                .all(|&it| self.sees_interface(viewer, it, sessions)),
        }
    }

    fn sees_interface(&self, viewer: NodeId, entity: EntityId, sessions: &Sessions) -> bool {
        if entity.node == viewer {
            return true;
        }
        if let Some((owner, name)) = self.ending.get(&entity) {
            return self.allows_sight(viewer, owner, Some(name));
        }
        let record = sessions.record(entity.node);
        record.is_some_and(|it| {
            let contract = it.contract(entity.interface);
            contract
                .is_some_and(|contract| self.allows_sight(viewer, it.name(), Some(contract.name())))
        })
    }

    /// Whether a session may see a node, or an interface of the node on a topic or service.
    //= SM2-ACC-010
    fn allows_sight(&self, node: NodeId, owner: &Name, subject: Option<&Name>) -> bool {
        let mut names = [Some(owner), subject].into_iter().flatten();
        names.all(|it| self.allows(node, Action::See, it))
    }

    /// Keeps the names of an interface whose links are to be ended.
    pub(super) fn begin_end(&mut self, entity: EntityId, contract: &Contract) {
        if let Some(subject) = self.subjects.get(&entity.node) {
            let names = (subject.node().clone(), contract.name().clone());
            self.ending.insert(entity, names);
        }
    }

    /// All links of the interface have ended.
    pub(super) fn complete_end(&mut self, entity: EntityId) {
        self.ending.remove(&entity);
    }

    /// Whether some names may be hidden from sessions.
    pub(super) const fn is_restricted(&self) -> bool {
        self.policy.is_some()
    }

    /// About how much one decision costs, in units of work.
    pub(super) fn cost(&self) -> usize {
        let tables = self.policy.as_ref().map(|it| it.tables());
        tables.map_or(0, |it| {
            it.rules.len() + it.bindings.len() + it.exclusive.len()
        })
    }

    /// Whether exactly these sessions, which are welcomed, are subjects.
    pub(super) fn is_about(&self, welcomed: impl Iterator<Item = NodeId>) -> bool {
        self.subjects.keys().copied().eq(welcomed)
    }
}

//= SM2-ACC-004, SM2-ACC-008
fn refuse_binding(policy: &AccessPolicy, user: &User, name: &Name) -> Result<(), Refusal> {
    match policy.binding_against(user, name) {
        None => Ok(()),
        Some(binding) => Err(Refusal::Denied {
            rule: Some(binding.name.clone()),
        }),
    }
}
