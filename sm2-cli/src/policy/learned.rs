//! The policy that allows what a domain was seen to do, and nothing else.

use std::{
    collections::{BTreeMap, BTreeSet},
    fmt,
};

use sm2_proto::{
    Contract, EntityId, Kind, Name,
    control::{Change, Item, Key},
    domain::Domain,
    policy::{Action, Subject, User},
};

/// The rights that were used, and the publishers of each topic.
#[derive(Debug, Default)]
pub(super) struct Learned {
    rights: BTreeMap<Who, BTreeMap<Action, BTreeSet<Name>>>,
    publishers: BTreeMap<Name, BTreeSet<EntityId>>,
    /// The topics that had several publishers at a time.
    shared: BTreeSet<Name>,
    /// Whether topics with one publisher become exclusive.
    exclusive: bool,
}

/// The subject of a rule.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Who {
    uid: u32,
    node: NodeCondition,
}

#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum NodeCondition {
    /// Any node: the name that was seen contains the number of its process, so it is another one next time.
    Any,
    /// The node of this name.
    Node(Name),
    /// The node that stands for this peer of a gateway.
    Peer(Name),
}

impl NodeCondition {
    fn new(uid: u32, name: &Name, pid: i32) -> Self {
        let user = User { uid, gids: vec![] };
        if let Some(peer) = Subject::new(user, name.clone()).peer() {
            return Self::Peer(peer.clone());
        }
        let pid = pid.to_string();
        let mut parts = name.as_str().split(['-', '_', '/']);
        match parts.any(|it| it == pid) {
            true => Self::Any,
            false => Self::Node(name.clone()),
        }
    }
}

impl Learned {
    pub(super) fn new(exclusive: bool) -> Self {
        Self {
            exclusive,
            ..Self::default()
        }
    }

    /// Learns from changes that led to the state `domain`. `itself` is the node that looks.
    pub(super) fn learn(&mut self, domain: &Domain, changes: &[Change], itself: &Name) {
        for change in changes {
            if let Change::Removed {
                key: Key::Member { entity },
            } = change
            {
                self.publishers.values_mut().for_each(|it| {
                    it.remove(entity);
                });
            }
        }
        for change in changes {
            let Change::Set {
                item: Item::Interface { entity, contract },
            } = change
            else {
                continue;
            };
            let node = EntityId::node(entity.node);
            let key = Key::Member { entity: node };
            if let Some(Item::Node { name, uid, pid, .. }) = domain.get(&key)
                && name != itself
            {
                let (uid, node) = (*uid, NodeCondition::new(*uid, name, *pid));
                self.declared(Who { uid, node }, *entity, contract);
            }
        }
    }

    fn declared(&mut self, who: Who, entity: EntityId, contract: &Contract) {
        let name = contract.name();
        let action = match contract.kind() {
            Kind::Publisher => Action::Publish,
            Kind::Subscriber => Action::Subscribe,
            Kind::Server => Action::Serve,
            Kind::Client => Action::Call,
        };
        let names = self.rights.entry(who).or_default();
        names.entry(action).or_default().insert(name.clone());
        if action == Action::Publish {
            let publishers = self.publishers.entry(name.clone()).or_default();
            publishers.insert(entity);
            if publishers.len() > 1 {
                self.shared.insert(name.clone());
            }
        }
    }

    /// The topics that never had several publishers at a time.
    fn exclusive_topics(&self) -> Vec<&Name> {
        let topics = self.publishers.keys();
        topics.filter(|it| !self.shared.contains(*it)).collect()
    }
}

/// The text of the policy file.
impl fmt::Display for Learned {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "# Learned by `sm2 policy learn`. Read it before you apply it."
        )?;
        writeln!(f, "default = \"deny\"")?;
        let users: BTreeSet<u32> = self.rights.keys().map(|it| it.uid).collect();
        if !users.is_empty() {
            let users: Vec<u32> = users.into_iter().collect();
            writeln!(f, "\n# Tools and gateways of these users see everything.")?;
            writeln!(f, "[[rule]]\neffect = \"allow\"")?;
            writeln!(
                f,
                "actions = [\"{}\", \"{}\"]",
                Action::See,
                Action::ReadCounters
            )?;
            writeln!(f, "names = [\"**\"]\nusers = {users:?}")?;
        }
        for (who, rights) in &self.rights {
            for (action, names) in rights {
                writeln!(
                    f,
                    "\n[[rule]]\neffect = \"allow\"\nactions = [\"{action}\"]"
                )?;
                writeln!(f, "names = [{}]", quoted(names))?;
                writeln!(f, "users = [{}]", who.uid)?;
                match &who.node {
                    NodeCondition::Any => {}
                    NodeCondition::Node(name) => writeln!(f, "nodes = [\"{name}\"]")?,
                    NodeCondition::Peer(name) => writeln!(f, "peers = [\"{name}\"]")?,
                }
            }
        }
        let topics = self.exclusive_topics();
        if self.exclusive && !topics.is_empty() {
            writeln!(f, "\n[[exclusive]]\ntopics = [{}]", quoted(topics))?;
        }
        Ok(())
    }
}

/// Names as members of a list. No character of a name needs an escape.
fn quoted<'a>(names: impl IntoIterator<Item = &'a Name>) -> String {
    let names = names.into_iter().map(|it| format!("\"{it}\""));
    names.collect::<Vec<_>>().join(", ")
}
