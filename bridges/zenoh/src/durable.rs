//! Durable topics: each message is sent until a bridge of the network has acknowledged it.
//!
//! | key expression | use |
//! | --- | --- |
//! | `PREFIX/@bridge/NAME` | liveliness token of each bridge that takes topics from the network |
//! | `PREFIX/@ack/NAME` | acknowledgements for a bridge: the payload is the topic, the attachment the [`Origin`] |
//!
//! Key expressions with wildcards do not match the chunks that begin with `@`.

use std::collections::BTreeSet;
use std::time::Duration;

use bytes::Bytes;
use sm2_bridge_core::BridgeError;
use sm2_bridge_core::config::SpoolConfig;
use sm2_bridge_core::domain::Topic;
use sm2_bridge_core::{Counts, Delivery, Durable, Origin, Outbox, REORDER_MAX, SpoolCounts};
use sm2_gateway::hub::DEFAULT_SEND_QOS;
use sm2_node::clock::wall_time;
use sm2_node::{Sample, now};
use sm2_proto::Name;
use sm2_proto::gateway::schedule::SendQos;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Subscriber;

use crate::network::{Message, Network, Subject};
use crate::plain;
use crate::sender::Channel;

/// How long an acknowledgement may take. The network is slow, or one of the two messages was dropped, if it takes
/// longer.
const RETRY: Duration = Duration::from_secs(5);

/// The messages of durable topics that no bridge has acknowledged.
pub(crate) struct DurableTopics {
    outbox: Outbox,
    /// The messages that wait for the network: at most those that the spool has in flight.
    channel: Channel,
    prefix: String,
    acks_key: String,
    _acks: Subscriber<()>,
    /// Whether another bridge takes topics from the network.
    has_receiver: bool,
}

impl DurableTopics {
    pub(crate) fn start(
        spool: &SpoolConfig,
        prefix: &str,
        name: &Name,
        network: &Network,
    ) -> Result<Self, BridgeError> {
        let limits = spool.limits.clone().with_retry(RETRY);
        let outbox = Outbox::open(&spool.folder, limits, now(), wall_time().0)
            .map_err(BridgeError::Spool)?;
        network.follow_tokens(format!("{prefix}/@bridge/**"))?;
        let acks_key = acks_key(prefix, name);
        let channel = network.channel(SendQos {
            depth: u16::try_from(REORDER_MAX).unwrap_or(u16::MAX),
            ..DEFAULT_SEND_QOS
        });
        channel.watch();
        Ok(Self {
            outbox,
            channel,
            prefix: prefix.to_owned(),
            _acks: network.subscribe_all(acks_key.clone())?,
            acks_key,
            has_receiver: false,
        })
    }

    /// Takes a message of the domain.
    pub(crate) fn offer(
        &mut self,
        topic: &Topic,
        origin: &Origin,
        sample: &Sample<[u8]>,
        counts: &mut Counts,
    ) {
        let message = Durable::new(topic, origin, sample);
        if let Err(error) = self.outbox.offer(message, now()) {
            counts.refused += 1;
            tracing::warn!(topic = %topic.0, %error, "a message of a durable topic is lost");
        }
    }

    /// Takes the tokens of the bridges that are there. `own` is the name of this bridge.
    pub(crate) fn follow_receivers(&mut self, tokens: &BTreeSet<String>, own: &Name) {
        let own = token_key(&self.prefix, own);
        let start = format!("{}/@bridge/", self.prefix);
        let mut receivers = tokens.iter().filter(|it| it.starts_with(&start));
        let has_receiver = receivers.any(|it| *it != own);
        if has_receiver == self.has_receiver {
            return;
        }
        self.has_receiver = has_receiver;
        match has_receiver {
            true => self.outbox.connect(),
            false => self.outbox.disconnect(now()),
        }
    }

    /// Whether the message is an acknowledgement, which this call handles.
    pub(crate) fn handle(&mut self, message: &Message) -> bool {
        if !matches!(&message.subject, Subject::Key(key) if *key == self.acks_key) {
            return false;
        }
        let topic = message.payload.to_bytes();
        let topic = str::from_utf8(&topic)
            .ok()
            .and_then(|it| Name::new(it).ok());
        let attachment = message.attachment.as_ref().map(|it| it.to_bytes());
        let origin = Origin::decode(attachment.as_deref().unwrap_or_default());
        if let (Some(topic), Ok((origin, _))) = (topic, origin) {
            self.outbox.acknowledge(&topic, &origin);
        }
        true
    }

    /// Sends what can be sent. While messages wait for the network, there is nothing to send: the spool would send
    /// them again.
    pub(crate) fn send(&mut self, network: &Network, counts: &mut Counts) {
        if !self.channel.is_idle() {
            return;
        }
        loop {
            let message = match self.outbox.poll(now()) {
                Ok(Some(message)) => message,
                Ok(None) => return,
                Err(error) => {
                    counts.refused += 1;
                    tracing::warn!(%error, "a message of a durable topic is lost");
                    continue;
                }
            };
            let key = plain::key(&self.prefix, &message.topic);
            let attachment = message.origin.encode(Delivery::AtLeastOnce);
            let encoding = plain::encoding(&message.data);
            network.put(&self.channel, key, encoding, message.payload, attachment);
        }
    }

    /// How long the bridge may wait until it has to [send](Self::send) again.
    pub(crate) fn timeout(&self) -> Option<Duration> {
        let deadline = self.outbox.deadline().filter(|_| self.channel.is_idle());
        deadline.map(|it| it.since(now()))
    }

    pub(crate) fn counts(&self) -> SpoolCounts {
        self.outbox.counts()
    }
}

/// Shows the bridges of durable topics that this one takes topics from the network.
pub(crate) fn declare_receiver(
    prefix: &str,
    name: &Name,
    network: &Network,
) -> Result<LivelinessToken, BridgeError> {
    network.declare_token(token_key(prefix, name))
}

/// Acknowledges a message that the domain has.
pub(crate) fn acknowledge(prefix: &str, topic: &Name, origin: &Origin, network: &Network) {
    let key = acks_key(prefix, &origin.bridge);
    let attachment = origin.encode(Delivery::AtMostOnce);
    let payload = Bytes::copy_from_slice(topic.as_str().as_bytes());
    network.acknowledge(key, payload, attachment);
}

fn token_key(prefix: &str, name: &Name) -> String {
    format!("{prefix}/@bridge/{name}")
}

fn acks_key(prefix: &str, name: &Name) -> String {
    format!("{prefix}/@ack/{name}")
}
