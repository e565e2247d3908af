//! The messages of the network that come to the domain.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Deref;

use sm2_node::Node;
use sm2_node::domain::Domain;
use sm2_proto::gateway::{Direction, SubjectKind};

use crate::config::RuleTables;
use crate::domain::{Topic, brought_by_gateways, has_bridge};
use crate::duplicates::Duplicates;
use crate::incoming::Incoming;
use crate::origin::{Delivery, Origin};

/// Publishes the messages of the network in the domain, each of them once.
pub struct Inbound {
    /// The node that stands for the network.
    remote: Node,
    topics: BTreeMap<Topic, Incoming>,
    duplicates: Duplicates,
    /// The topics that gateways bring to the domain.
    of_gateways: BTreeSet<Topic>,
}

/// A message of the network, without its payload.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Arrival {
    /// The topic and the type.
    pub topic: Topic,
    /// `None` if no bridge has put it into the network.
    pub origin: Option<Origin>,
    /// Whether its bridge waits for an acknowledgement.
    pub delivery: Delivery,
}

/// The end of a message of the network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The rules do not let it in.
    Denied,
    /// It comes from a bridge of the same domain.
    Returned,
    /// A gateway of its domain carries it, and one of this domain brings its topic.
    LeftToGateway,
    /// It was published before.
    Duplicate,
    /// The domain refuses it.
    Refused,
    /// The domain has it.
    Published,
}

impl Inbound {
    /// `remote` is the node that stands for the network.
    #[must_use]
    pub fn new(remote: Node) -> Self {
        Self {
            remote,
            topics: BTreeMap::new(),
            duplicates: Duplicates::default(),
            of_gateways: BTreeSet::new(),
        }
    }

    /// The node that stands for the network.
    #[must_use]
    pub const fn remote(&self) -> &Node {
        &self.remote
    }

    /// Follows a change of the domain.
    pub fn follow(&mut self, domain: &Domain) {
        self.of_gateways = brought_by_gateways(domain);
    }

    /// Offers topics of the network to the domain, each with the number of messages that it keeps for late joiners, and
    /// no others.
    pub fn offer(&mut self, domain: &Domain, offered: BTreeMap<Topic, u16>) {
        (self.topics).retain(|topic, it| offered.get(topic) == Some(&it.latched()));
        for (topic, latched) in offered {
            self.declare(domain, &topic, latched, Delivery::AtMostOnce);
        }
    }

    /// Publishes a message, whose `payload` is asked for only then.
    pub fn receive<P: Deref<Target = [u8]>>(
        &mut self,
        rules: &RuleTables,
        domain: &Domain,
        arrival: &Arrival,
        payload: impl FnOnce() -> P,
    ) -> Verdict {
        let Arrival {
            topic,
            origin,
            delivery,
        } = arrival;
        let decision = rules.explain(SubjectKind::Topic, &topic.0, Direction::In);
        if !decision.is_allowed {
            return Verdict::Denied;
        }
        if let Some(origin) = origin {
            if has_bridge(domain, &origin.bridge) {
                return Verdict::Returned;
            }
            if *delivery == Delivery::BesideGateway && self.of_gateways.contains(topic) {
                return Verdict::LeftToGateway;
            }
            if self.duplicates.contains(&topic.0, origin) {
                return Verdict::Duplicate;
            }
        }
        let Some(incoming) = self.declare(domain, topic, 0, *delivery) else {
            return Verdict::Refused;
        };
        if let Err(error) = incoming.publish(&payload()) {
            tracing::warn!(topic = %topic.0, %error, "cannot publish a message in the domain");
            return Verdict::Refused;
        }
        if let Some(origin) = origin {
            self.duplicates.insert(&topic.0, origin);
        }
        Verdict::Published
    }

    /// The publisher of a topic, which is declared if it is missing. `None` if the domain refuses it.
    fn declare(
        &mut self,
        domain: &Domain,
        topic: &Topic,
        latched: u16,
        delivery: Delivery,
    ) -> Option<&Incoming> {
        if !self.topics.contains_key(topic) {
            match Incoming::declare(&self.remote, domain, topic, latched, delivery) {
                Ok(incoming) => drop(self.topics.insert(topic.clone(), incoming)),
                Err(error) => {
                    tracing::warn!(topic = %topic.0, %error, "cannot publish in the domain");
                }
            }
        }
        self.topics.get(topic)
    }
}
