//! A topic of the domain that goes to the network.

use std::thread;
use std::time::Duration;

use bytes::Bytes;
use sm2_bridge_core::domain::Topic;
use sm2_bridge_core::{Delivery, Origin, publication_time};
use sm2_gateway::is_remote;
use sm2_node::wait_set::Key;
use sm2_node::{Node, RecvError, Sample, Subscriber};
use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;
use zenoh_ext::AdvancedPublisher;

use crate::counts::Counts;
use crate::durable::DurableTopics;
use crate::ros2::{self, Gid};

/// How many messages of each publisher wait for the bridge.
const DEPTH: u16 = 64;
/// How many messages are borrowed at most: those that wait in Zenoh.
const MAX_BORROWED: u16 = 16;
/// How long the bridge waits for Zenoh to give one of them back.
const BORROWED_PAUSE: Duration = Duration::from_millis(1);
/// How many messages are taken at once, so that no topic delays the others.
const BURST: usize = 64;

/// A topic with publishers in the domain.
pub(crate) struct Outgoing {
    publisher: AdvancedPublisher<'static>,
    form: Form,
    keep: Keep,
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
    fn attachment(&self, sample: &Sample<[u8]>, origin: &Origin) -> Vec<u8> {
        match self {
            Self::Plain => origin.encode(Delivery::AtMostOnce),
            Self::Ros2 { gid, .. } => ros2::encode(publication_time(sample), gid, origin),
        }
    }
}

impl Outgoing {
    pub(crate) const fn new(
        publisher: AdvancedPublisher<'static>,
        form: Form,
        keep: Keep,
        origin: Origin,
    ) -> Self {
        Self {
            publisher,
            form,
            keep,
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
                // The set would report the topic at once.
                Err(RecvError::TooManyBorrowed { .. }) => {
                    thread::sleep(BORROWED_PAUSE);
                    return Ok(());
                }
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
            let attachment = self.form.attachment(&sample, &self.origin);
            let payload = match self.keep == Keep::Latched {
                // Zenoh keeps it for long, and a subscriber may borrow a few messages only.
                true => Bytes::copy_from_slice(&sample),
                false => Bytes::from_owner(Borrowed(sample)),
            };
            let put = self.publisher.put(payload).attachment(attachment);
            match put.wait() {
                Ok(()) => counts.sent += 1,
                Err(error) => {
                    counts.refused += 1;
                    tracing::warn!(key = %self.publisher.key_expr(), %error, "Zenoh refuses a message");
                }
            }
        }
        Ok(())
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
struct Borrowed(Sample<[u8]>);

impl AsRef<[u8]> for Borrowed {
    fn as_ref(&self) -> &[u8] {
        &self.0
    }
}
