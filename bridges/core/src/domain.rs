//! The topics of a domain's own interfaces. Those of bridges and gateways are left out: they stand for others.

use std::collections::BTreeSet;

use sm2_node::domain::Domain;
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
    let topic = |contract: &Contract| match contract {
        Contract::Publisher { topic, data, .. } => Some((topic.clone(), data.clone())),
        _ => None,
    };
    contracts(domain).filter_map(topic).collect()
}

/// The topics to which programs of the domain subscribe. `None` stands for messages of every type.
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

fn contracts(domain: &Domain) -> impl Iterator<Item = &Contract> {
    let interfaces = domain.interfaces().filter(|it| {
        let node = domain.node(it.entity.node);
        it.refused.is_none() && node.is_some_and(|node| !is_relay(node.name))
    });
    interfaces.map(|it| it.contract)
}

/// Whether a bridge of this name is a node of a domain.
#[must_use]
pub fn has_bridge(domain: &Domain, bridge: &Name) -> bool {
    domain.node_named(&format!("bridge/{bridge}")).is_some()
}

fn is_relay(node: &Name) -> bool {
    RELAYS.iter().any(|it| node.as_str().starts_with(it))
}
