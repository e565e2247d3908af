//! A topic of the network that comes to the domain.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use sm2_node::domain::Domain;
use sm2_node::{DeclareError, Node, PublishError, Publisher};

use crate::Delivery;
use crate::domain::{Topic, subscribers};

/// How many messages wait for a slow subscriber.
const DEPTH: u16 = 64;
/// How long the first messages wait for the links to the subscribers that are there.
const LINKS_WAIT: Duration = Duration::from_millis(100);
/// The same for messages that must not be lost.
const DURABLE_LINKS_WAIT: Duration = Duration::from_secs(10);

/// A publisher that stands for those of the network.
///
/// The links to its subscribers open after its declaration. Until then its messages wait, so that a subscriber that was
/// there gets the first one.
pub(crate) struct Incoming<M> {
    publisher: Publisher<[u8]>,
    latched: u16,
    /// How many subscribers were there when it was declared. It waits for as many links.
    subscribers: usize,
    /// When its messages wait no longer. `None` from then on.
    waits_until: Option<Instant>,
    waiting: VecDeque<M>,
}

impl<M> Incoming<M> {
    /// Declares the publisher, whose first message has this delivery. It keeps the last `latched` messages for late
    /// joiners.
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
        let wait = match delivery {
            Delivery::AtMostOnce | Delivery::BesideGateway => LINKS_WAIT,
            Delivery::AtLeastOnce => DURABLE_LINKS_WAIT,
        };
        Ok(Self {
            publisher,
            latched,
            subscribers: subscribers(domain, topic),
            waits_until: Some(Instant::now() + wait),
            waiting: VecDeque::new(),
        })
    }

    /// How many messages it keeps for late joiners.
    pub(crate) const fn latched(&self) -> u16 {
        self.latched
    }

    /// Whether messages have to wait for its links.
    pub(crate) fn is_waiting(&mut self) -> bool {
        let Some(until) = self.waits_until else {
            return false;
        };
        let open = self.publisher.links().iter().filter(|it| it.open).count();
        if open >= self.subscribers || Instant::now() >= until {
            self.waits_until = None;
        }
        self.waits_until.is_some()
    }

    /// Keeps a message that has to wait.
    pub(crate) fn keep(&mut self, message: M) {
        self.waiting.push_back(message);
    }

    /// The messages that have waited, in their order.
    pub(crate) fn take_waiting(&mut self) -> VecDeque<M> {
        std::mem::take(&mut self.waiting)
    }

    /// Whether messages wait.
    pub(crate) fn has_waiting(&self) -> bool {
        !self.waiting.is_empty()
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
