//! The form of ROS 2: the key expressions, tokens and attachments of rmw_zenoh.
//!
//! All interfaces that the bridge carries are those of one node of ROS 2, `/sm2/NAME`.

mod attachment;
mod graph;
mod identity;
mod known;
mod types;

use std::collections::{BTreeMap, BTreeSet};

use hiroz_protocol::EndpointKind;
use hiroz_protocol::qos::{QosDurability, QosHistory, QosProfile, QosReliability};
use sm2_bridge_core::BridgeError;
use sm2_bridge_core::domain::{Service, Topic, called, served, subscribed};
use sm2_node::{Node, WaitSet};
use sm2_proto::gateway::Direction;
use sm2_proto::{Name, OfferedQos};
use zenoh::bytes::Encoding;
use zenoh::liveliness::LivelinessToken;
use zenoh_ext::AdvancedPublisher;

use self::graph::Endpoint;
use self::identity::{Identity, declare_token, gid, key, token_key};
use self::known::Known;
use self::types::RosType;
use crate::network::{Network, TopicSubscriber};
use crate::ready::Ready;
use crate::services::{Declared, Form, Services};
use crate::sides::Sides;

pub(crate) use self::attachment::{Gid, encode, origin, reply};

/// The state of a bridge that follows the conventions of ROS 2.
pub(crate) struct Ros2 {
    identity: Identity,
    known: Known,
    /// The endpoints of the network.
    endpoints: Vec<Endpoint>,
    /// The bridges of the network.
    bridges: BTreeSet<Name>,
    subscriptions: BTreeMap<Topic, Subscription>,
}

/// A subscription in the network. Ends when it is dropped.
struct Subscription {
    /// Whether it has asked for old messages.
    history: bool,
    _subscriber: TopicSubscriber,
    _token: LivelinessToken,
}

/// A publisher in the network. Ends when it is dropped.
pub(crate) struct RosPublisher {
    pub(crate) publisher: AdvancedPublisher<'static>,
    pub(crate) gid: Gid,
    pub(crate) token: LivelinessToken,
}

impl Ros2 {
    /// Declares the node.
    pub(crate) fn start(
        name: &Name,
        domain_id: u8,
        network: &Network,
    ) -> Result<Self, BridgeError> {
        let identity = Identity::declare(name, domain_id, network)?;
        network.follow_tokens(graph::tokens(domain_id))?;
        Ok(Self {
            identity,
            known: Known::default(),
            endpoints: Vec::new(),
            bridges: BTreeSet::new(),
            subscriptions: BTreeMap::new(),
        })
    }

    /// Reads all tokens again.
    pub(crate) fn read_graph(&mut self, tokens: &BTreeSet<String>) {
        let endpoints = tokens.iter().filter_map(|it| Endpoint::read(it));
        self.endpoints = endpoints.collect();
        let bridges = tokens.iter().filter_map(|it| graph::bridge(it));
        self.bridges = bridges.collect();
        let types = self.endpoints.iter().map(|it| it.data.clone());
        self.known.set_network(types);
    }

    /// Whether a bridge of this name is a node of ROS 2.
    pub(crate) fn has_bridge(&self, bridge: &Name) -> bool {
        self.bridges.contains(bridge)
    }

    /// The topics with publishers in the network that the rules let in, and how many messages these publishers keep
    /// for late joiners.
    pub(crate) fn offered(&self, sides: &Sides<'_>) -> BTreeMap<Topic, u16> {
        let mut offered = BTreeMap::new();
        for it in self.foreign(EndpointKind::Publisher, sides) {
            if sides.config.allows(&it.name, Direction::In) {
                let latched = offered
                    .entry((it.name.clone(), it.data.data()))
                    .or_default();
                *latched = it.latched.max(*latched);
            }
        }
        offered
    }

    /// The endpoints of a kind, without those that a bridge has declared for the domain.
    fn foreign(&self, kind: EndpointKind, sides: &Sides<'_>) -> impl Iterator<Item = &Endpoint> {
        self.endpoints.iter().filter(move |it| {
            let bridge = it.bridge.as_ref();
            it.kind == kind && !bridge.is_some_and(|bridge| sides.has_bridge(bridge))
        })
    }

    /// Subscribes to the topics that the domain wants and the rules let in, and to no others.
    pub(crate) fn follow_subscribers(
        &mut self,
        sides: &Sides<'_>,
        offered: &BTreeMap<Topic, u16>,
    ) -> Result<(), BridgeError> {
        let mut wanted = BTreeSet::new();
        for (name, data) in subscribed(sides.domain) {
            if !sides.config.allows(&name, Direction::In) {
                continue;
            }
            match data {
                Some(data) => drop(wanted.insert((name, data))),
                None => wanted.extend(offered.keys().filter(|it| it.0 == name).cloned()),
            }
        }
        // Zenoh drops messages that overtake each other on their way to a subscriber with history. Publishers that keep
        // messages number them, the others do not.
        let has_history = |topic: &Topic| offered.get(topic) != Some(&0);
        (self.subscriptions)
            .retain(|topic, it| wanted.contains(topic) && it.history == has_history(topic));
        for topic in wanted {
            if self.subscriptions.contains_key(&topic) {
                continue;
            }
            let Some(data) = self.known.message(sides.node, &topic.1) else {
                continue;
            };
            let qos = QosProfile::default();
            let endpoint =
                (self.identity).endpoint(EndpointKind::Subscription, &topic.0, &data, qos);
            let history = has_history(&topic);
            let subscription = Subscription {
                history,
                _subscriber: (sides.network).subscribe(key(&endpoint)?, topic.clone(), history)?,
                _token: declare_token(&endpoint, sides.network)?,
            };
            self.subscriptions.insert(topic, subscription);
        }
        Ok(())
    }

    /// Declares the publisher of a topic of the domain. `None` if its type is not one of ROS 2.
    pub(crate) fn publisher(
        &mut self,
        topic: &Topic,
        offer: Option<OfferedQos>,
        node: &Node,
        network: &Network,
    ) -> Result<Option<RosPublisher>, BridgeError> {
        let Some(data) = self.known.message(node, &topic.1) else {
            return Ok(None);
        };
        let latched = offer.map_or(0, |it| it.latched);
        let qos = offer.map(qos).unwrap_or_default();
        let endpoint = (self.identity).endpoint(EndpointKind::Publisher, &topic.0, &data, qos);
        let encoding = Encoding::default();
        Ok(Some(RosPublisher {
            publisher: network.publisher(key(&endpoint)?, encoding, topic, latched)?,
            gid: gid(&endpoint, network),
            token: declare_token(&endpoint, network)?,
        }))
    }

    /// Offers each side the services of the other one that the rules let pass.
    pub(crate) fn follow_services(
        &mut self,
        services: &mut Services,
        sides: &Sides<'_>,
        set: &mut WaitSet<'static, Ready>,
    ) -> Result<(), BridgeError> {
        let mut offered = BTreeMap::new();
        for service in served(sides.domain) {
            if sides.config.allows_service(&service.0, Direction::Out)
                && let Some(data) = self.known.service(sides.node, &service.1, &service.2)
            {
                offered.insert(service, data);
            }
        }
        let mut wanted = BTreeMap::new();
        for service in called(sides.domain) {
            if sides.config.allows_service(&service.0, Direction::In)
                && let Some(data) = self.known.service(sides.node, &service.1, &service.2)
                && (self.foreign(EndpointKind::Service, sides))
                    .any(|it| it.name == service.0 && it.data == data)
            {
                wanted.insert(service, data);
            }
        }
        let identity = &mut self.identity;
        let mut declare = |kind, service: &Service, data: RosType| {
            let endpoint = identity.endpoint(kind, &service.0, &data, QosProfile::default());
            Ok(Declared {
                key: key(&endpoint)?,
                token: Some(token_key(&endpoint, sides.network)?),
                form: Form::Ros2(gid(&endpoint, sides.network)),
            })
        };
        services.offer(offered, sides, |it, data| {
            declare(EndpointKind::Service, it, data)
        })?;
        services.stand_for(wanted, sides, set, |it, data| {
            declare(EndpointKind::Client, it, data)
        })
    }
}

/// The QoS as ROS 2 shows it.
fn qos(offer: OfferedQos) -> QosProfile {
    QosProfile {
        reliability: match offer.reliable {
            true => QosReliability::Reliable,
            false => QosReliability::BestEffort,
        },
        durability: match offer.latched {
            0 => QosDurability::Volatile,
            _ => QosDurability::TransientLocal,
        },
        history: QosHistory::from_depth(match offer.latched {
            0 => offer.depth.into(),
            latched => latched.into(),
        }),
        ..QosProfile::default()
    }
}
