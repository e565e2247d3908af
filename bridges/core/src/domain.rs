//! The topics of a domain's own interfaces. Those of bridges and gateways are left out: they stand for others.

use std::collections::BTreeSet;

use sm2_node::domain::Domain;
use sm2_proto::gateway::Direction;
use sm2_proto::{Contract, Name, OfferedQos, TypeId};

/// A topic, and the type of its messages.
pub type Topic = (Name, TypeId);

/// A service, and the types of its requests and replies.
pub type Service = (Name, TypeId, TypeId);

/// The starts of the names of nodes that belong to bridges and gateways.
const RELAYS: [&str; 3] = ["bridge/", "gateway/", "remote/"];

/// The topics that programs of the domain publish.
#[must_use]
pub fn published(domain: &Domain) -> BTreeSet<Topic> {
    contracts(domain).filter_map(published_topic).collect()
}

/// The topics that programs of the domain subscribe to. `None` stands for messages of every type.
#[must_use]
pub fn subscribed(domain: &Domain) -> BTreeSet<(Name, Option<TypeId>)> {
    let topic = |contract: &Contract| match contract {
        Contract::Subscriber { topic, data, .. } => Some((topic.clone(), data.clone())),
        _ => None,
    };
    contracts(domain).filter_map(topic).collect()
}

/// The services that programs of the domain offer.
#[must_use]
pub fn served(domain: &Domain) -> BTreeSet<Service> {
    let service = |contract: &Contract| match contract {
        Contract::Server {
            service,
            request,
            reply,
            ..
        } => Some((service.clone(), request.clone(), reply.clone())),
        _ => None,
    };
    contracts(domain).filter_map(service).collect()
}

/// The services that programs of the domain call. Tools that call services of every type are left out.
#[must_use]
pub fn called(domain: &Domain) -> BTreeSet<Service> {
    let service = |contract: &Contract| match contract {
        Contract::Client {
            service,
            types: Some((request, reply)),
            ..
        } => Some((service.clone(), request.clone(), reply.clone())),
        _ => None,
    };
    contracts(domain).filter_map(service).collect()
}

/// The QoS of the first publisher of a topic, for tools of the network. `None` if the topic has none any more.
#[must_use]
pub fn offer(domain: &Domain, (topic, data): &Topic) -> Option<OfferedQos> {
    contracts(domain).find_map(|it| match it {
        Contract::Publisher {
            topic: its,
            data: sent,
            offer,
        } if its == topic && sent == data => Some(*offer),
        _ => None,
    })
}

/// How many subscribers of the domain take a topic.
#[must_use]
pub fn subscribers(domain: &Domain, (topic, data): &Topic) -> usize {
    let takes = |contract: &&Contract| match contract {
        Contract::Subscriber {
            topic: its,
            data: wanted,
            ..
        } => its == topic && wanted.as_ref().is_none_or(|it| it == data),
        _ => false,
    };
    let all = domain.interfaces().map(|it| it.contract);
    all.filter(takes).count()
}

/// The topics that gateways bring to the domain: their nodes `remote/NAME` publish them.
#[must_use]
pub fn brought_by_gateways(domain: &Domain) -> BTreeSet<Topic> {
    let is_of_gateway = |node: &Name| {
        let peer = node.as_str().strip_prefix("remote/");
        let peer = peer.and_then(|it| Name::new(it).ok());
        peer.is_some_and(|it| !has_bridge(domain, &it))
    };
    let topics = contracts_of(domain, is_of_gateway).filter_map(published_topic);
    topics.collect()
}

/// The topics that gateways carry to other domains: their nodes `gateway/NAME` subscribe to them.
#[must_use]
pub fn carried_by_gateways(domain: &Domain) -> BTreeSet<Topic> {
    let is_gateway = |node: &Name| node.as_str().starts_with("gateway/");
    let topics = contracts_of(domain, is_gateway).filter_map(|it| match it {
        Contract::Subscriber { topic, data, .. } => Some((topic.clone(), data.clone()?)),
        _ => None,
    });
    topics.collect()
}

fn published_topic(contract: &Contract) -> Option<Topic> {
    match contract {
        Contract::Publisher { topic, data, .. } => Some((topic.clone(), data.clone())),
        _ => None,
    }
}

fn contracts(domain: &Domain) -> impl Iterator<Item = &Contract> {
    contracts_of(domain, |node| !is_relay(node))
}

/// The contracts of the nodes with these names.
fn contracts_of(domain: &Domain, is_of: impl Fn(&Name) -> bool) -> impl Iterator<Item = &Contract> {
    let interfaces = domain.interfaces().filter(move |it| {
        let node = domain.node(it.entity.node);
        it.refused.is_none() && node.is_some_and(|node| is_of(node.name))
    });
    interfaces.map(|it| it.contract)
}

/// The topics that both the bridge `own` and another bridge carry in the same direction, with the name of the other
/// one. A bridge carries a topic out while its node `bridge/NAME` subscribes to it, and in while `remote/NAME`
/// publishes it.
#[must_use]
pub fn carried_twice(domain: &Domain, own: &Name) -> BTreeSet<(Name, Topic, Direction)> {
    let (mut carried, mut others) = (BTreeSet::new(), BTreeSet::new());
    for interface in domain.interfaces().filter(|it| it.refused.is_none()) {
        let Some(node) = domain.node(interface.entity.node) else {
            continue;
        };
        let node = node.name.as_str();
        let (bridge, topic, direction) = match interface.contract {
            Contract::Subscriber {
                topic,
                data: Some(data),
                ..
            } => (node.strip_prefix("bridge/"), (topic, data), Direction::Out),
            Contract::Publisher { topic, data, .. } => {
                (node.strip_prefix("remote/"), (topic, data), Direction::In)
            }
            _ => continue,
        };
        let bridge = bridge.and_then(|it| Name::new(it).ok());
        let topic = (topic.0.clone(), topic.1.clone());
        match bridge {
            Some(bridge) if bridge == *own => drop(carried.insert((topic, direction))),
            // A gateway has nodes `remote/NAME`, too.
            Some(bridge) if has_bridge(domain, &bridge) => {
                others.insert((bridge, topic, direction));
            }
            _ => {}
        }
    }
    others.retain(|(_, topic, direction)| carried.contains(&(topic.clone(), *direction)));
    others
}

/// Whether a bridge of this name is a node of a domain.
#[must_use]
pub fn has_bridge(domain: &Domain, bridge: &Name) -> bool {
    domain.node_named(&format!("bridge/{bridge}")).is_some()
}

fn is_relay(node: &Name) -> bool {
    RELAYS.iter().any(|it| node.as_str().starts_with(it))
}
