//! The form that topics, types and attachments have in the network: that of SM2, or that of ROS 2.

use sm2_bridge_core::BridgeError;
use sm2_bridge_core::domain::{Topic, offer};
use sm2_bridge_core::{Arrival, Delivery, Origin};
use sm2_node::Node;
use sm2_node::domain::Domain;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;

use crate::config::{Config, Mode};
use crate::durable;
use crate::network::{Message, Network, Subject};
use crate::outgoing::{Form, Keep, Outgoing};
use crate::plain;
use crate::ros2::{self, Ros2};

/// The convention that the configuration names, and its state.
pub(crate) enum Convention {
    Plain {
        prefix: String,
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
                Self::Plain {
                    prefix: prefix.clone(),
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
                Some(Outgoing::new(publisher, Form::Plain, keep, origin))
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
                    Outgoing::new(it.publisher, Form::Ros2 { gid, _token }, keep, origin)
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
                let origin = ros2::origin(attachment);
                (
                    Topic::clone(topic),
                    origin.map(|it| (it, Delivery::AtMostOnce)),
                )
            }
            _ => return None,
        };
        // A message without an origin comes from a program that is no bridge.
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
