//! The messages of the network that come to the domain.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use sm2_node::Node;
use sm2_node::domain::Domain;
use sm2_proto::gateway::{Direction, SubjectKind};

use crate::config::RuleTables;
use crate::domain::{Topic, brought_by_gateways, has_bridge};
use crate::duplicates::Duplicates;
use crate::incoming::Incoming;
use crate::origin::{Delivery, Origin};

/// How many messages wait for links at most, those of all topics together.
const WAITING_MAX: usize = 1_024;
/// How many bytes they have at most.
const WAITING_BYTES_MAX: usize = 64 << 20;
/// How often messages that wait for links are tried.
const LINKS_INTERVAL: Duration = Duration::from_millis(2);

/// A message as the network has it.
pub trait Payload {
    /// The bytes of the message.
    fn payload(&self) -> Cow<'_, [u8]>;
}

/// Publishes the messages of the network in the domain, each of them once.
///
/// The first messages of a topic wait until the links to its subscribers are open. Nothing else waits for that:
/// [`Inbound::take_ended`] tells the end of each message.
pub struct Inbound<M> {
    /// The node that stands for the network.
    remote: Node,
    topics: BTreeMap<Topic, Incoming<(Arrival, M)>>,
    duplicates: Duplicates,
    /// The topics that gateways bring to the domain.
    of_gateways: BTreeSet<Topic>,
    /// How many messages wait for links, and their bytes.
    waiting: (usize, usize),
    ended: Vec<Ended<M>>,
}

/// A message that has come to its end.
#[derive(Clone, Debug)]
pub struct Ended<M> {
    /// Its topic and its origin.
    pub arrival: Arrival,
    /// The message itself.
    pub message: M,
    /// Its end.
    pub verdict: Verdict,
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
    /// It has to wait for links, and too many others wait already.
    Dropped,
    /// The domain has it.
    Published,
}

impl<M: Payload> Inbound<M> {
    /// `remote` is the node that stands for the network.
    #[must_use]
    pub fn new(remote: Node) -> Self {
        Self {
            remote,
            topics: BTreeMap::new(),
            duplicates: Duplicates::default(),
            of_gateways: BTreeSet::new(),
            waiting: (0, 0),
            ended: Vec::new(),
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
        let is_gone =
            |(topic, it): &(&Topic, &Incoming<_>)| offered.get(*topic) != Some(&it.latched());
        let gone = self.topics.iter().filter(is_gone);
        let gone: Vec<Topic> = gone.map(|(topic, _)| topic.clone()).collect();
        for topic in gone {
            self.publish_waiting(&topic);
            self.topics.remove(&topic);
        }
        for (topic, latched) in offered {
            self.declare(domain, &topic, latched, Delivery::AtMostOnce);
        }
    }

    /// Takes a message of the network. [`Inbound::take_ended`] has it as soon as it has come to its end.
    pub fn receive(&mut self, rules: &RuleTables, domain: &Domain, arrival: Arrival, message: M) {
        if let Some(verdict) = self.judge(rules, domain, &arrival) {
            self.end(arrival, message, verdict);
            return;
        }
        let Some(incoming) = self.declare(domain, &arrival.topic, 0, arrival.delivery) else {
            self.end(arrival, message, Verdict::Refused);
            return;
        };
        if !incoming.is_waiting() {
            let topic = arrival.topic.clone();
            self.publish_waiting(&topic);
            self.publish(arrival, message);
            return;
        }
        let (messages, bytes) = self.waiting;
        let bytes = bytes.saturating_add(message.payload().len());
        if messages == WAITING_MAX || bytes > WAITING_BYTES_MAX {
            self.end(arrival, message, Verdict::Dropped);
            return;
        }
        self.waiting = (messages + 1, bytes);
        if let Some(incoming) = self.topics.get_mut(&arrival.topic) {
            incoming.keep((arrival, message));
        }
    }

    /// The messages that have come to their end since the last call, among them those that wait no longer.
    pub fn take_ended(&mut self) -> Vec<Ended<M>> {
        if self.waiting.0 > 0 {
            let waited = |(topic, it): (&Topic, &mut Incoming<_>)| {
                (it.has_waiting() && !it.is_waiting()).then(|| topic.clone())
            };
            let waited: Vec<Topic> = self.topics.iter_mut().filter_map(waited).collect();
            for topic in waited {
                self.publish_waiting(&topic);
            }
        }
        std::mem::take(&mut self.ended)
    }

    /// Publishes the messages that wait, because the bridge ends.
    pub fn take_all(&mut self) -> Vec<Ended<M>> {
        let topics: Vec<Topic> = self.topics.keys().cloned().collect();
        for topic in topics {
            self.publish_waiting(&topic);
        }
        std::mem::take(&mut self.ended)
    }

    /// When [`Inbound::take_ended`] is to be called again. `None` while no message waits.
    #[must_use]
    pub fn timeout(&self) -> Option<Duration> {
        (self.waiting.0 > 0).then_some(LINKS_INTERVAL)
    }

    /// The end of a message that is not published.
    fn judge(&self, rules: &RuleTables, domain: &Domain, arrival: &Arrival) -> Option<Verdict> {
        let Arrival {
            topic,
            origin,
            delivery,
        } = arrival;
        let decision = rules.explain(SubjectKind::Topic, &topic.0, Direction::In);
        if !decision.is_allowed {
            return Some(Verdict::Denied);
        }
        let origin = origin.as_ref()?;
        if has_bridge(domain, &origin.bridge) {
            return Some(Verdict::Returned);
        }
        if *delivery == Delivery::BesideGateway && self.of_gateways.contains(topic) {
            return Some(Verdict::LeftToGateway);
        }
        self.is_duplicate(arrival).then_some(Verdict::Duplicate)
    }

    fn is_duplicate(&self, arrival: &Arrival) -> bool {
        let origin = arrival.origin.as_ref();
        origin.is_some_and(|it| self.duplicates.contains(&arrival.topic.0, it))
    }

    /// Publishes the messages of a topic that have waited.
    fn publish_waiting(&mut self, topic: &Topic) {
        let Some(incoming) = self.topics.get_mut(topic) else {
            return;
        };
        for (arrival, message) in incoming.take_waiting() {
            self.waiting.0 -= 1;
            self.waiting.1 -= message.payload().len();
            self.publish(arrival, message);
        }
    }

    /// Publishes a message, unless it came twice while it waited.
    fn publish(&mut self, arrival: Arrival, message: M) {
        let verdict = if self.is_duplicate(&arrival) {
            Verdict::Duplicate
        } else if let Some(incoming) = self.topics.get(&arrival.topic) {
            match incoming.publish(&message.payload()) {
                Ok(()) => Verdict::Published,
                Err(error) => {
                    tracing::warn!(topic = %arrival.topic.0, %error, "cannot publish a message in the domain");
                    Verdict::Refused
                }
            }
        } else {
            Verdict::Refused
        };
        if verdict == Verdict::Published
            && let Some(origin) = &arrival.origin
        {
            self.duplicates.insert(&arrival.topic.0, origin);
        }
        self.end(arrival, message, verdict);
    }

    fn end(&mut self, arrival: Arrival, message: M, verdict: Verdict) {
        self.ended.push(Ended {
            arrival,
            message,
            verdict,
        });
    }

    /// The publisher of a topic, which is declared if it is missing. `None` if the domain refuses it.
    fn declare(
        &mut self,
        domain: &Domain,
        topic: &Topic,
        latched: u16,
        delivery: Delivery,
    ) -> Option<&mut Incoming<(Arrival, M)>> {
        if !self.topics.contains_key(topic) {
            match Incoming::declare(&self.remote, domain, topic, latched, delivery) {
                Ok(incoming) => drop(self.topics.insert(topic.clone(), incoming)),
                Err(error) => {
                    tracing::warn!(topic = %topic.0, %error, "cannot publish in the domain");
                }
            }
        }
        self.topics.get_mut(topic)
    }
}
