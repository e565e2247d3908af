//! The counters of the gateways' nodes, which answer no commands.

use std::path::Path;

use sm2_node::{
    Node,
    domain::{EntityId, QueryError},
};
use sm2_tests::TIMEOUT;

use crate::ledger::{self, End};

/// A node in each domain, which reads the counters of others.
pub(crate) struct Inspector([Node; 2]);

impl Inspector {
    /// Connects to the domains with these sockets.
    pub(crate) fn new(sockets: [&Path; 2]) -> Self {
        Self(sockets.map(|socket| {
            let builder = Node::builder("inspector").socket(socket);
            let node = builder.manager_timeout(TIMEOUT).connect();
            node.expect("a session with a new Manager")
        }))
    }

    /// The gateways' ends of the links of topics. Nothing of a domain whose Manager changes.
    pub(crate) fn gateway_ends(&self) -> Vec<(String, End)> {
        let ends = self.0.iter().filter_map(|node| ends(node).ok());
        ends.flatten().collect()
    }
}

fn ends(node: &Node) -> Result<Vec<(String, End)>, QueryError> {
    let domain = node.snapshot()?;
    let mut ends = Vec::new();
    for gateway in domain.nodes() {
        if !ledger::is_of_gateway(gateway.name) {
            continue;
        }
        let Some(counters) = node.inspect(gateway.node)? else {
            continue;
        };
        for entry in counters.entries().filter_map(|(_, it)| it.ok()) {
            let entity = EntityId {
                node: gateway.node,
                interface: entry.interface,
            };
            let is_open = domain.links().any(|it| Some(it.link) == entry.link);
            let end = domain.interface(entity).filter(|_| is_open);
            let end = end.and_then(|it| End::of_entry(&entry, it.contract));
            ends.extend(end.map(|it| (gateway.name.to_string(), it)));
        }
    }
    Ok(ends)
}
