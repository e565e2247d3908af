//! The connection graph: which nodes publish, subscribe and serve.

use std::collections::{BTreeMap, BTreeSet};

use sm2_proto::{Contract, Name, domain::Domain};

use crate::protocol::{GraphUpdate, Providers, Publishers, Subscribers};

/// The names of nodes for each name of a topic or service.
type Nodes = BTreeMap<Name, BTreeSet<Name>>;

/// The connection graph of a domain.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Graph {
    publishers: Nodes,
    subscribers: Nodes,
    servers: Nodes,
}

impl Graph {
    /// Reads the interfaces of a domain, without those of the node `own`.
    pub(crate) fn new(domain: &Domain, own: &Name) -> Self {
        let mut graph = Self::default();
        for interface in domain.interfaces().filter(|it| it.refused.is_none()) {
            let Some(node) = domain
                .node(interface.entity.node)
                .filter(|it| it.name != own)
            else {
                continue;
            };
            let (nodes, name) = match interface.contract {
                Contract::Publisher { topic, .. } => (&mut graph.publishers, topic),
                Contract::Subscriber { topic, .. } => (&mut graph.subscribers, topic),
                Contract::Server { service, .. } => (&mut graph.servers, service),
                // The protocol has no callers.
                Contract::Client { .. } => continue,
            };
            nodes
                .entry(name.clone())
                .or_default()
                .insert(node.name.clone());
        }
        graph
    }

    /// The update for a viewer that knows the graph `before`. `None` if nothing has changed.
    pub(crate) fn update(&self, before: &Self) -> Option<GraphUpdate> {
        let update = GraphUpdate {
            published_topics: changed(&self.publishers, &before.publishers, |name, ids| {
                Publishers {
                    name,
                    publisher_ids: ids,
                }
            }),
            subscribed_topics: changed(&self.subscribers, &before.subscribers, |name, ids| {
                Subscribers {
                    name,
                    subscriber_ids: ids,
                }
            }),
            advertised_services: changed(&self.servers, &before.servers, |name, ids| Providers {
                name,
                provider_ids: ids,
            }),
            removed_topics: removed(&self.topics(), &before.topics()),
            removed_services: removed(
                &self.servers.keys().collect(),
                &before.servers.keys().collect(),
            ),
        };
        (update != GraphUpdate::default()).then_some(update)
    }

    fn topics(&self) -> BTreeSet<&Name> {
        self.publishers
            .keys()
            .chain(self.subscribers.keys())
            .collect()
    }
}

/// The entries that are new or different. A name that has lost its last node has an empty entry.
fn changed<T>(now: &Nodes, before: &Nodes, entry: impl Fn(String, Vec<String>) -> T) -> Vec<T> {
    let names: BTreeSet<_> = now.keys().chain(before.keys()).collect();
    let differing = names
        .into_iter()
        .filter(|it| now.get(*it) != before.get(*it));
    differing
        .map(|name| {
            let nodes = now.get(name).into_iter().flatten();
            entry(name.to_string(), nodes.map(Name::to_string).collect())
        })
        .collect()
}

fn removed(now: &BTreeSet<&Name>, before: &BTreeSet<&Name>) -> Vec<String> {
    before.difference(now).map(|it| it.to_string()).collect()
}
