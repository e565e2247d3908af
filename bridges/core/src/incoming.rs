//! A topic of the network that comes to the domain.

use std::thread;
use std::time::{Duration, Instant};

use sm2_node::domain::Domain;
use sm2_node::{DeclareError, Node, PublishError, Publisher};

use crate::Delivery;
use crate::domain::{Topic, subscribers};

/// How many messages wait for a slow subscriber.
const DEPTH: u16 = 64;
/// How long the first message waits for the links to the subscribers that are there.
const LINKS_WAIT: Duration = Duration::from_millis(100);
/// The same for a message that must not be lost.
const DURABLE_LINKS_WAIT: Duration = Duration::from_secs(10);

/// A publisher that stands for those of the network.
pub(crate) struct Incoming {
    publisher: Publisher<[u8]>,
    latched: u16,
}

impl Incoming {
    /// Declares the publisher, and waits a short time for the subscribers of the domain, so that they get the first
    /// message, which has this delivery. It keeps the last `latched` messages for late joiners.
    ///
    /// # Errors
    ///
    /// See [`DeclareError`].
    pub(crate) fn declare(
        node: &Node,
        domain: &Domain,
        topic: &Topic,
        latched: u16,
        delivery: Delivery,
    ) -> Result<Self, DeclareError> {
        let publisher = node
            .publisher_builder::<[u8]>(topic.0.as_str())
            .type_id(topic.1.clone())
            .depth(DEPTH)
            .latched(latched)
            // A subscriber without room misses the message: it must not delay the others.
            .publish_timeout(Duration::ZERO)
            .declare()?;
        let subscribers = subscribers(domain, topic);
        let wait = match delivery {
            Delivery::AtMostOnce | Delivery::BesideGateway => LINKS_WAIT,
            Delivery::AtLeastOnce => DURABLE_LINKS_WAIT,
        };
        let until = Instant::now() + wait;
        let open = |it: &Publisher<[u8]>| it.links().iter().filter(|it| it.open).count();
        while open(&publisher) < subscribers && Instant::now() < until {
            thread::sleep(Duration::from_millis(1));
        }
        Ok(Self { publisher, latched })
    }

    /// How many messages it keeps for late joiners.
    pub(crate) const fn latched(&self) -> u16 {
        self.latched
    }

    /// Publishes a message. A subscriber without room misses it.
    ///
    /// # Errors
    ///
    /// See [`PublishError`].
    pub(crate) fn publish(&self, payload: &[u8]) -> Result<(), PublishError> {
        self.publisher.publish(payload).map(drop)
    }
}
