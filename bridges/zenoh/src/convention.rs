//! The form that topics, types and attachments have in the network: that of SM2, or that of ROS 2.

use std::collections::BTreeSet;

use sm2_bridge_core::BridgeError;
use sm2_bridge_core::domain::{Service, Topic, called, offer, served};
use sm2_bridge_core::{Arrival, Delivery, Origin};
use sm2_node::domain::Domain;
use sm2_node::{Node, WaitSet};
use sm2_proto::gateway::{Direction, SubjectKind};
use sm2_proto::{Name, OfferedQos};
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;

use crate::config::{Config, Mode};
use crate::durable;
use crate::network::{Message, Network, Subject};
use crate::outgoing::{Form, Keep, Outgoing};
use crate::plain;
use crate::ready::Ready;
use crate::ros2::{self, Ros2};
use crate::sender::Channel;
use crate::services::{self, Declared, Services};
use crate::sides::Sides;

/// How many messages of a reliable topic wait for the network at most; of others, as many as its publisher keeps.
const RELIABLE_DEPTH: u16 = 64;

/// The convention that the configuration names, and its state.
pub(crate) enum Convention {
    Plain {
        prefix: String,
        /// The services of the network, by the bridges that offer them.
        servers: BTreeSet<(Name, Service)>,
        /// The bridges of the network, and the token of this one.
        bridges: BTreeSet<Name>,
        _member: LivelinessToken,
        /// The subscription, and the token that shows it to other bridges. `None` if the rules let nothing in.
        _incoming: Option<(Subscriber<()>, LivelinessToken)>,
    },
    Ros2(Box<Ros2>),
}

impl Convention {
    pub(crate) fn start(config: &Config, network: &Network) -> Result<Self, BridgeError> {
        Ok(match &config.mode {
            Mode::Plain { prefix } => {
                let subscribe = || {
                    let subscriber = network.subscribe_all(format!("{prefix}/**"))?;
                    let token = durable::declare_receiver(prefix, &config.name, network)?;
                    Ok::<_, BridgeError>((subscriber, token))
                };
                network.follow_tokens(format!("{}**", plain::service_tokens(prefix)))?;
                network.follow_tokens(format!("{}**", plain::member_tokens(prefix)))?;
                Self::Plain {
                    prefix: prefix.clone(),
                    servers: BTreeSet::new(),
                    bridges: BTreeSet::new(),
                    _member: network.declare_token(plain::member_token(prefix, &config.name))?,
                    _incoming: config.rules.lets_in().then(subscribe).transpose()?,
                }
            }
            Mode::Ros2 { domain_id } => {
                Self::Ros2(Box::new(Ros2::start(&config.name, *domain_id, network)?))
            }
        })
    }

    /// Declares a topic of the domain in the network. `None` if its type has no name there.
    pub(crate) fn declare(
        &mut self,
        config: &Config,
        topic: &Topic,
        origin: Origin,
        domain: &Domain,
        node: &Node,
        network: &Network,
    ) -> Result<Option<Outgoing>, BridgeError> {
        Ok(match self {
            Self::Plain { prefix, .. } => {
                let key = plain::key(prefix, &topic.0);
                let publisher = network.publisher(key, plain::encoding(&topic.1), topic, 0)?;
                let keep = match config.is_durable(&topic.0) {
                    true => Keep::Durable,
                    false => Keep::Live,
                };
                let channel = channel(config, topic, offer(domain, topic), network);
                Some(Outgoing::new(publisher, Form::Plain, keep, channel, origin))
            }
            Self::Ros2(ros2) => {
                let offer = offer(domain, topic);
                let is_latched = offer.is_some_and(|it| it.latched > 0);
                let declared = ros2.publisher(topic, offer, node, network)?;
                declared.map(|it| {
                    let (gid, _token) = (it.gid, it.token);
                    let keep = match is_latched {
                        true => Keep::Latched,
                        false => Keep::Live,
                    };
                    let channel = channel(config, topic, offer, network);
                    let form = Form::Ros2 { gid, _token };
                    Outgoing::new(it.publisher, form, keep, channel, origin)
                })
            }
        })
    }

    /// Reads the topic of a message, and its origin if a bridge has put it into the network. `None` if the domain has
    /// no names for the topic or its type.
    pub(crate) fn read(&self, message: &Message) -> Option<Arrival> {
        let attachment = message.attachment.as_ref().map(|it| it.to_bytes());
        let attachment = attachment.as_deref().unwrap_or_default();
        let (topic, origin) = match (self, &message.subject) {
            (Self::Plain { prefix, .. }, Subject::Key(key)) => {
                let topic = (
                    plain::topic(prefix, key)?,
                    plain::type_of(&message.encoding)?,
                );
                (topic, Origin::decode(attachment).ok())
            }
            (Self::Ros2(_), Subject::Topic(topic)) => {
                (Topic::clone(topic), ros2::origin(attachment))
            }
            _ => return None,
        };
        // A message without an origin comes from a program that is not a bridge.
        let (origin, delivery) = origin
            .map_or((None, Delivery::AtMostOnce), |(origin, delivery)| {
                (Some(origin), delivery)
            });
        Some(Arrival {
            topic,
            origin,
            delivery,
        })
    }

    /// Reads all liveliness tokens of the network again.
    pub(crate) fn read_tokens(&mut self, tokens: &BTreeSet<String>) {
        match self {
            Self::Plain {
                prefix,
                servers,
                bridges,
                ..
            } => {
                let services = tokens.iter();
                *servers = services
                    .filter_map(|it| plain::service_of(prefix, it))
                    .collect();
                let members = tokens.iter();
                *bridges = members
                    .filter_map(|it| plain::member_of(prefix, it))
                    .collect();
            }
            Self::Ros2(ros2) => ros2.read_graph(tokens),
        }
    }

    /// Whether a bridge of this name is in the network.
    pub(crate) fn has_bridge(&self, bridge: &Name) -> bool {
        match self {
            Self::Plain { bridges, .. } => bridges.contains(bridge),
            Self::Ros2(ros2) => ros2.has_bridge(bridge),
        }
    }

    /// Offers each side the services of the other one that the rules let pass.
    pub(crate) fn follow_services(
        &mut self,
        services: &mut Services,
        sides: &Sides<'_>,
        set: &mut WaitSet<'static, Ready>,
    ) -> Result<(), BridgeError> {
        let (prefix, servers) = match self {
            Self::Plain {
                prefix, servers, ..
            } => (prefix, servers),
            Self::Ros2(ros2) => return ros2.follow_services(services, sides, set),
        };
        let allows = |service: &Service, direction| {
            let is_allowed = sides.config.allows_service(&service.0, direction);
            is_allowed.then(|| (service.clone(), ()))
        };
        let offered = served(sides.domain);
        let offered = offered.iter().filter_map(|it| allows(it, Direction::Out));
        let is_foreign = |service: &Service| {
            let mut offers = servers.iter().filter(|it| it.1 == *service);
            offers.any(|(bridge, _)| !sides.has_bridge(bridge))
        };
        let wanted = called(sides.domain);
        let wanted = wanted.iter().filter(|it| is_foreign(it));
        let wanted = wanted.filter_map(|it| allows(it, Direction::In));
        let declare = |service: &Service, token| Declared {
            key: plain::key(prefix, &service.0),
            token,
            form: services::Form::Plain(service.clone()),
        };
        services.offer(offered.collect(), sides, |it, ()| {
            let token = plain::service_token(prefix, &sides.config.name, it);
            Ok(declare(it, Some(token)))
        })?;
        services.stand_for(wanted.collect(), sides, set, |it, ()| Ok(declare(it, None)))
    }

    /// Acknowledges a message, if its bridge waits for that.
    pub(crate) fn acknowledge(&self, arrival: &Arrival, network: &Network) {
        if let Self::Plain { prefix, .. } = self
            && let Some(origin) = &arrival.origin
            && arrival.delivery == Delivery::AtLeastOnce
        {
            durable::acknowledge(prefix, &arrival.topic.0, origin, network);
        }
    }
}

/// The messages of a topic that wait for the network.
fn channel(
    config: &Config,
    topic: &Topic,
    offer: Option<OfferedQos>,
    network: &Network,
) -> Channel {
    let decision = config.explain(SubjectKind::Topic, &topic.0, Direction::Out);
    let depth = offer.map_or(1, |it| match it.reliable {
        true => it.depth.max(RELIABLE_DEPTH),
        false => it.depth.max(it.latched),
    });
    network.channel(decision.budget.send_qos(depth))
}
