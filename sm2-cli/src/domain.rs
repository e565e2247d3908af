//! What there is in a domain, from the pages of a QUERY: topics and nodes with their counts.

use std::collections::BTreeMap;

use serde::Serialize;
use sm2_proto::{Contract, Kind, Name, NodeId, TypeId, control::Item};

/// A topic.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Topic {
    pub(crate) name: String,
    /// None if nobody has stated one.
    #[serde(rename = "type")]
    pub(crate) data: Option<Type>,
    pub(crate) publishers: u64,
    pub(crate) subscribers: u64,
    pub(crate) links: u64,
}

/// A message type. The schema's hash is text: not every reader of JSON has 64-bit numbers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Type {
    pub(crate) name: String,
    pub(crate) schema: String,
}

/// A node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Node {
    pub(crate) id: u64,
    pub(crate) name: String,
    pub(crate) uid: u32,
    pub(crate) pid: i32,
    pub(crate) publishers: u64,
    pub(crate) subscribers: u64,
    pub(crate) servers: u64,
    pub(crate) clients: u64,
    /// Ends of links: a link between two interfaces of one node counts twice.
    pub(crate) links: u64,
}

/// The topics of a domain, in the order of their names.
pub(crate) fn topics(items: &[Item]) -> Vec<Topic> {
    let mut topics: BTreeMap<&Name, Topic> = BTreeMap::new();
    for item in items {
        let Item::Interface {
            contract, links, ..
        } = item
        else {
            continue;
        };
        let (data, publishes) = match contract {
            Contract::Publisher { data, .. } => (Some(data), true),
            Contract::Subscriber { data, .. } => (data.as_ref(), false),
            Contract::Server { .. } | Contract::Client { .. } => continue,
        };
        let topic = topics.entry(contract.name()).or_insert_with(|| Topic {
            name: contract.name().to_string(),
            data: None,
            publishers: 0,
            subscribers: 0,
            links: 0,
        });
        topic.data = topic.data.take().or_else(|| data.map(Type::from));
        if publishes {
            topic.publishers += 1;
            // Each link has one publisher: counted there, it is counted once.
            topic.links += u64::from(*links);
        } else {
            topic.subscribers += 1;
        }
    }
    topics.into_values().collect()
}

/// The nodes of a domain, in the order of their coming, without the one named `itself`.
pub(crate) fn nodes(items: &[Item], itself: &Name) -> Vec<Node> {
    let mut nodes: BTreeMap<u64, Node> = BTreeMap::new();
    for item in items {
        match item {
            Item::Node { name, .. } if name == itself => {}
            Item::Node {
                node,
                name,
                uid,
                pid,
            } => {
                nodes.insert(node.0, Node::new(*node, name, *uid, *pid));
            }
            Item::Interface {
                node,
                contract,
                links,
                ..
            } => {
                // A node comes before its interfaces, if it is one of these.
                if let Some(node) = nodes.get_mut(&node.0) {
                    node.count(contract.kind(), *links);
                }
            }
        }
    }
    nodes.into_values().collect()
}

impl Node {
    fn new(node: NodeId, name: &Name, uid: u32, pid: i32) -> Self {
        Self {
            id: node.0,
            name: name.to_string(),
            uid,
            pid,
            publishers: 0,
            subscribers: 0,
            servers: 0,
            clients: 0,
            links: 0,
        }
    }

    fn count(&mut self, kind: Kind, links: u32) {
        let of_kind = match kind {
            Kind::Publisher => &mut self.publishers,
            Kind::Subscriber => &mut self.subscribers,
            Kind::Server => &mut self.servers,
            Kind::Client => &mut self.clients,
        };
        *of_kind += 1;
        self.links += u64::from(links);
    }
}

impl From<&TypeId> for Type {
    fn from(data: &TypeId) -> Self {
        Self {
            name: data.name.to_string(),
            schema: format!("{:016x}", data.hash),
        }
    }
}

#[cfg(test)]
mod tests;
