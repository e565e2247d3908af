//! One topic of a recording.

use std::sync::Arc;

use sm2_node::domain::Contract;
use sm2_node::wait_set::Key;
use sm2_node::{Node, RecvError, Sample, Subscriber};
use sm2_proto::control::LinkPeer;
use sm2_proto::{Instant, Name, OfferedQos, TypeId};

use crate::clock::ClockRelation;
use crate::gap::{Gap, GapReason};
use crate::source::{Source, UNKNOWN_OFFER};
use crate::writer::MessageTimes;

/// A topic that is recorded, and its publishers.
pub(super) struct Topic {
    pub(super) subscriber: Subscriber<[u8]>,
    pub(super) wait: Wait,
    pub(super) polling: Polling,
    /// Whether its publishers wait when the queue has no room.
    pub(super) is_reliable: bool,
    /// Whether it is known to have had a link.
    pub(super) was_linked: bool,
    /// When the recorder subscribed to it, in nanoseconds of the wall clock.
    pub(super) since_ns: u64,
    /// Few, and most often one.
    publishers: Vec<Publisher>,
}

/// The frequency of a topic, which decides whether it is polled.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Polling {
    /// The number of messages since a time, while the recorder waits for each of them.
    pub(super) since: Instant,
    pub(super) messages: u64,
    /// When a poll found messages for the last time.
    pub(super) taken_at: Instant,
    /// How many messages a poll may find.
    pub(super) most: u64,
    /// Whether messages were displaced between two polls. The topic is never polled again.
    pub(super) has_lost: bool,
}

/// The event for which the recorder waits before it takes messages of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wait {
    /// The next message: this is the place of the subscriber in the wait set.
    Message(Key),
    /// The next poll.
    Poll,
    /// Room in the queue for a reliable topic, or in the wait set.
    Room,
}

struct Publisher {
    source: Arc<Source>,
    /// The `log_time` of its last message that was recorded.
    last_time: Option<u64>,
}

/// A message that was taken.
pub(super) struct Taken {
    pub(super) source: Arc<Source>,
    pub(super) times: MessageTimes,
    /// The messages before it that newer ones displaced.
    pub(super) displaced: Option<Gap>,
    /// The place of its publisher.
    publisher: usize,
}

impl Topic {
    pub(super) fn new(
        subscriber: Subscriber<[u8]>,
        key: Key,
        is_reliable: bool,
        since_ns: u64,
    ) -> Self {
        Self {
            subscriber,
            wait: Wait::Message(key),
            polling: Polling::default(),
            is_reliable,
            was_linked: false,
            since_ns,
            publishers: Vec::new(),
        }
    }

    /// Appends the messages that one call finds, at most `most`, to `samples`, which is empty. Returns their number.
    pub(super) fn take(
        &self,
        samples: &mut Vec<Sample<[u8]>>,
        most: usize,
    ) -> Result<usize, RecvError> {
        match self.subscriber.try_recv_many(samples, most) {
            // The writer gives back soon.
            Ok(_) | Err(RecvError::TooManyBorrowed { .. }) => {}
            // The other publishers are recorded further on.
            Err(error @ RecvError::Map { .. }) => {
                let topic = self.subscriber.topic();
                tracing::error!(%topic, %error, "a message is not recorded");
            }
            Err(error) => return Err(error),
        }
        Ok(samples.len())
    }

    /// Describes a message that was taken at `now`, a time of the wall clock. `None` if its sender is not a publisher,
    /// which the Manager never links.
    pub(super) fn note(
        &mut self,
        node: &Node,
        sample: &Sample<[u8]>,
        clock: &ClockRelation,
        now: u64,
    ) -> Option<Taken> {
        let (name, data) = (sample.publisher(), sample.type_id()?);
        let is_it = |it: &Publisher| it.source.publisher == *name && it.source.data == *data;
        let number = match self.publishers.iter().position(is_it) {
            Some(number) => number,
            None => {
                self.publishers.push(self.publisher(node, name, data));
                self.publishers.len() - 1
            }
        };
        let Publisher { source, last_time } = &self.publishers[number];
        let displaced = (sample.lost() > 0).then(|| Gap {
            publisher: source.publisher.to_string(),
            from_ns: last_time.unwrap_or(now),
            to_ns: now,
            messages: sample.lost(),
            reason: GapReason::Displaced,
        });
        Some(Taken {
            source: Arc::clone(source),
            times: MessageTimes {
                // MCAP has 32 bits.
                sequence: sample.sequence() as u32,
                log_time: now,
                publish_time: clock.wall_at(sample.source_time()),
            },
            displaced,
            publisher: number,
        })
    }

    /// Describes the publisher of a message.
    fn publisher(&self, node: &Node, name: &Name, data: &TypeId) -> Publisher {
        let links = self.subscriber.links();
        let offer = links.iter().find_map(|it| offer_of(&it.peer, name, data));
        let source = Source {
            topic: self.subscriber.topic().clone(),
            publisher: name.clone(),
            data: data.clone(),
            // The link of a message that waited may be gone by now.
            offer: offer.unwrap_or(UNKNOWN_OFFER),
            // Without a Manager, the type has no text in the bag; its name and hash are there.
            schema: node.describe(data).ok().flatten(),
        };
        Publisher {
            source: Arc::new(source),
            last_time: None,
        }
    }

    /// The length of the shortest queue between a publisher and the recorder, in messages.
    pub(super) fn shortest_queue(&self) -> u16 {
        let depth = |contract: &Contract| match contract {
            Contract::Publisher { offer, .. } => Some(offer.depth),
            _ => None,
        };
        let links = self.subscriber.links();
        let depths = links.iter().filter_map(|it| depth(&it.peer.contract));
        depths.min().unwrap_or_default()
    }

    /// Notes whether it has, or has had, a link.
    pub(super) fn look_for_link(&mut self) {
        self.was_linked =
            self.was_linked || !self.publishers.is_empty() || !self.subscriber.links().is_empty();
    }

    /// How many publishers the topic has had.
    pub(super) fn publishers(&self) -> usize {
        self.publishers.len()
    }

    /// The message will be in the bag.
    pub(super) fn note_recorded(&mut self, taken: &Taken) {
        self.publishers[taken.publisher].last_time = Some(taken.times.log_time);
    }

    /// Forgets the publishers that have left, of which there may be very many one after the other. Returns those that
    /// are latched. One that comes back is described again, and sends its latched messages again.
    pub(super) fn take_left(&mut self) -> Vec<Arc<Source>> {
        if self.publishers.is_empty() {
            return Vec::new();
        }
        let links = self.subscriber.links();
        let is_there = |source: &Source| {
            let is_it = |it: &LinkPeer| offer_of(it, &source.publisher, &source.data).is_some();
            links.iter().any(|it| it.open && is_it(&it.peer))
        };
        let left = self.publishers.extract_if(.., |it| !is_there(&it.source));
        let latched = left.filter(|it| it.source.offer.latched > 0);
        let left = latched.map(|it| it.source).collect();
        self.was_linked = true;
        left
    }

    /// The gap that a message leaves which is dropped for this reason.
    pub(super) fn dropped(&self, taken: &Taken, reason: GapReason) -> Gap {
        let last = self.publishers[taken.publisher].last_time;
        Gap {
            publisher: taken.source.publisher.to_string(),
            from_ns: last.unwrap_or(taken.times.log_time),
            to_ns: taken.times.log_time,
            messages: 1,
            reason,
        }
    }
}

/// The QoS that the other end of a link offers, if it is the publisher of this name and type.
fn offer_of(peer: &LinkPeer, name: &Name, data: &TypeId) -> Option<OfferedQos> {
    match &peer.contract {
        Contract::Publisher {
            data: its, offer, ..
        } if its == data && peer.name == *name => Some(*offer),
        _ => None,
    }
}
