//! A topic of the domain that goes to the network.

use std::sync::Arc;

use bytes::Bytes;
use sm2_bridge_core::domain::Topic;
use sm2_bridge_core::{Counts, Delivery, Origin, publication_time};
use sm2_gateway::is_remote;
use sm2_node::wait_set::Key;
use sm2_node::{Node, RecvError, Sample, Subscriber};
use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;
use zenoh_ext::AdvancedPublisher;

use crate::durable::DurableTopics;
use crate::network::outcome;
use crate::ros2::{self, Gid};
use crate::sender::Channel;

/// How many messages of each publisher wait for the bridge.
const DEPTH: u16 = 64;
/// How many messages are borrowed at most.
const MAX_BORROWED: u16 = 16;
/// Messages up to this length are copied, which frees their slots at once.
const COPY_MAX_BYTES: usize = 16 << 10;
/// Longer messages are borrowed while fewer than this many are, and copied from then on: those that wait for a slow
/// network must not use up what the bridge may borrow.
const COPY_FROM_BORROWED: usize = 8;
/// How many messages are taken at once, so that no topic delays the others.
const BURST: usize = 64;

/// A topic with publishers in the domain.
pub(crate) struct Outgoing {
    publisher: Arc<AdvancedPublisher<'static>>,
    form: Form,
    keep: Keep,
    /// The messages that wait for the network.
    channel: Channel,
    /// Whether a gateway of the domain carries the topic, too.
    pub(crate) is_beside_gateway: bool,
    /// Each borrowed message has a reference.
    borrowed: Arc<()>,
    /// While there are subscribers in the network: the subscriber in the domain, and its place in the wait set.
    pub(crate) taken: Option<(Subscriber<[u8]>, Key)>,
    /// That of the last message.
    origin: Origin,
}

/// The messages that are kept.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Keep {
    /// None.
    Live,
    /// Zenoh keeps the last ones for late joiners.
    Latched,
    /// Each one until a bridge has acknowledged it.
    Durable,
}

/// The form of the attachments of a topic.
pub(crate) enum Form {
    Plain,
    /// That of ROS 2. The token shows the publisher to nodes of ROS 2.
    Ros2 {
        gid: Gid,
        _token: LivelinessToken,
    },
}

impl Form {
    fn attachment(&self, sample: &Sample<[u8]>, origin: &Origin, delivery: Delivery) -> Vec<u8> {
        match self {
            Self::Plain => origin.encode(delivery),
            Self::Ros2 { gid, .. } => ros2::encode(publication_time(sample), gid, origin, delivery),
        }
    }
}

impl Outgoing {
    pub(crate) fn new(
        publisher: AdvancedPublisher<'static>,
        form: Form,
        keep: Keep,
        channel: Channel,
        origin: Origin,
    ) -> Self {
        Self {
            publisher: Arc::new(publisher),
            form,
            keep,
            channel,
            is_beside_gateway: false,
            borrowed: Arc::new(()),
            taken: None,
            origin,
        }
    }

    /// Whether the network has a subscriber, or may have one that wants the messages of today.
    pub(crate) fn is_wanted(&self) -> bool {
        if self.keep != Keep::Live {
            return true;
        }
        let status = self.publisher.matching_status().wait();
        // Without an answer, a message is worth the attempt.
        status.map_or(true, |it| it.matching())
    }

    /// Passes the messages of `topic` that have come to the network, or to `durable`, as far as one burst goes.
    pub(crate) fn forward(
        &mut self,
        topic: &Topic,
        durable: Option<&mut DurableTopics>,
        counts: &mut Counts,
    ) -> Result<(), RecvError> {
        let mut durable = durable.filter(|_| self.keep == Keep::Durable);
        let Some((subscriber, _)) = &self.taken else {
            return Ok(());
        };
        for _ in 0..BURST {
            let sample = match subscriber.try_recv() {
                Ok(Some(sample)) => sample,
                Ok(None) => return Ok(()),
                Err(error) => return Err(error),
            };
            counts.lost += sample.lost();
            if is_remote(sample.publisher()) {
                continue;
            }
            self.origin.number += 1;
            if let Some(durable) = &mut durable {
                durable.offer(topic, &self.origin, &sample, counts);
                continue;
            }
            self.send(sample);
        }
        Ok(())
    }

    /// Passes a message to the network.
    fn send(&self, sample: Sample<[u8]>) {
        let delivery = match self.is_beside_gateway {
            true => Delivery::BesideGateway,
            false => Delivery::AtMostOnce,
        };
        let attachment = self.form.attachment(&sample, &self.origin, delivery);
        let (len, published_at) = (sample.len(), sample.source_time());
        // One reference is that of the topic. Zenoh keeps latched messages for long.
        let has_few_left = Arc::strong_count(&self.borrowed) > COPY_FROM_BORROWED;
        let is_copied = len <= COPY_MAX_BYTES || has_few_left || self.keep == Keep::Latched;
        let payload = match is_copied {
            true => Bytes::copy_from_slice(&sample),
            false => Bytes::from_owner(Borrowed {
                sample,
                _counted: Arc::clone(&self.borrowed),
            }),
        };
        let publisher = Arc::clone(&self.publisher);
        let put = move || {
            let put = publisher.put(payload).attachment(attachment);
            outcome(publisher.key_expr(), put.wait())
        };
        self.channel.put(len, published_at, Box::new(put));
    }
}

/// Declares the subscriber of a topic.
pub(crate) fn subscribe(
    node: &Node,
    (topic, data): &Topic,
) -> Result<Subscriber<[u8]>, sm2_node::DeclareError> {
    let builder = node.subscriber_builder::<[u8]>(topic.as_str());
    builder
        .type_id(data.clone())
        .depth(DEPTH)
        .max_borrowed(MAX_BORROWED)
        .declare()
}

/// A message in the slot of its publisher.
struct Borrowed {
    sample: Sample<[u8]>,
    _counted: Arc<()>,
}

impl AsRef<[u8]> for Borrowed {
    fn as_ref(&self) -> &[u8] {
        &self.sample
    }
}
