//! One topic of a recording.

use std::collections::BTreeMap;
use std::sync::Arc;

use sm2_node::diagnostics::{Counters, LinkStatus};
use sm2_node::domain::Contract;
use sm2_node::wait_set::Key;
use sm2_node::{Node, RecvError, Sample, Subscriber};
use sm2_proto::control::LinkPeer;
use sm2_proto::link::Fate;
use sm2_proto::{Instant, LinkId, Name, OfferedQos, Period, TypeId};

use super::fates::{Known, Loss};
use super::publisher::Publisher;
use crate::clock::ClockRelation;
use crate::gap::GapReason;
use crate::queue::Queue;
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
    pub(super) losses: Losses,
    /// How often a call found all messages that had come.
    emptied: u64,
    /// Few, and most often one.
    publishers: Vec<Publisher>,
}

/// The messages of a topic that are not recorded.
#[derive(Default)]
pub(super) struct Losses {
    /// Whether it is logged that a message was too long.
    has_logged_too_long: bool,
    /// When the counters of its publishers were last read because messages were missing.
    pub(super) looked_at: Option<Instant>,
    /// The losses that they have shown, for each link.
    of_links: BTreeMap<LinkId, Known>,
    /// Whether a publisher had too little memory, because the recorder held messages.
    pub(super) is_pool_short: bool,
}

/// The frequency of a topic, which decides whether it is polled.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Polling {
    /// The number of messages since a time, while the recorder waits for each of them.
    pub(super) since: Instant,
    pub(super) messages: u64,
    /// When a poll found messages for the last time.
    pub(super) taken_at: Instant,
    /// When the polls began. The messages before that have the times when they were taken.
    pub(super) from: Instant,
    /// How many messages a poll may find.
    pub(super) most: u64,
    /// Whether messages were displaced between two polls. The topic is never polled again.
    pub(super) has_lost: bool,
}

/// The event that the recorder waits for before it takes messages of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wait {
    /// The next message: this is the place of the subscriber in the wait set.
    Message(Key),
    /// The next poll.
    Poll,
    /// Room in the queue for a reliable topic, or in the wait set.
    Room,
}

/// A message that was taken.
pub(super) struct Taken {
    pub(super) source: Arc<Source>,
    pub(super) times: MessageTimes,
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
            losses: Losses::default(),
            emptied: 0,
            publishers: Vec::new(),
        }
    }

    /// Appends the messages that one call finds, at most `most`, to `samples`, which is empty. Returns their number.
    pub(super) fn take(
        &mut self,
        samples: &mut Vec<Sample<[u8]>>,
        most: usize,
    ) -> Result<usize, RecvError> {
        match self.subscriber.try_recv_many(samples, most) {
            Ok(_) => self.emptied += u64::from(samples.len() < most),
            // The writer gives back soon.
            Err(RecvError::TooManyBorrowed { .. }) => {}
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
    pub(super) fn describe(
        &mut self,
        node: &Node,
        sample: &Sample<[u8]>,
        clock: &ClockRelation,
        now: u64,
    ) -> Option<Taken> {
        let number = self.number(node, sample.publisher(), sample.type_id()?);
        Some(Taken {
            source: Arc::clone(&self.publishers[number].source),
            times: MessageTimes {
                // MCAP has 32 bits.
                sequence: sample.sequence() as u32,
                log_time: now,
                publish_time: clock.wall_at(sample.source_time()),
            },
            publisher: number,
        })
    }

    /// The place of the publisher of this name and type, which is added if it is new.
    fn number(&mut self, node: &Node, name: &Name, data: &TypeId) -> usize {
        match self.publishers.iter().position(|it| it.is(name, data)) {
            Some(number) => number,
            None => {
                self.publishers.push(self.publisher(node, name, data));
                self.publishers.len() - 1
            }
        }
    }

    /// Counts the messages that are missing before this one, which comes at `now`. Returns the number of those that
    /// were not counted before. `is_explained`: the counters of the publisher were read before.
    pub(super) fn count_lost(
        &mut self,
        node: &Node,
        sample: &Sample<[u8]>,
        now: u64,
        is_explained: bool,
    ) -> u64 {
        let Some(data) = sample.type_id() else {
            return 0;
        };
        let number = self.number(node, sample.publisher(), data);
        self.publishers[number].show(now, sample.lost(), is_explained)
    }

    /// Counts the messages that the links have lost since the last look. Returns the number of messages.
    pub(super) fn look_at_losses(
        &mut self,
        node: &Node,
        now: u64,
        mut fates: impl FnMut(&LinkStatus) -> Option<Counters>,
    ) -> u64 {
        let links = self.subscriber.links();
        (self.losses.of_links).retain(|id, _| links.iter().any(|it| it.id == *id));
        let mut losses = Vec::new();
        for link in links {
            let Contract::Publisher { data, .. } = &link.peer.contract else {
                continue;
            };
            let known = self.losses.of_links.entry(link.id).or_insert_with(|| {
                let its = |it: &&mut Publisher| it.is(&link.peer.name, data);
                if let Some(publisher) = self.publishers.iter_mut().find(its) {
                    publisher.begin_link();
                }
                Known::default()
            });
            let look = known.advance(&link.received, fates(&link).as_ref());
            let its: Vec<_> = look.losses.filter(|it| it.messages > 0).collect();
            // A publisher that has left is forgotten, and its link has no more news.
            if look.displaced > 0 || !its.is_empty() {
                let number = self.number(node, &link.peer.name, data);
                self.publishers[number].displace(look.displaced);
                losses.extend(its.into_iter().map(|it| (number, it)));
            }
        }
        let mut lost = 0;
        // All links of a publisher have told what was displaced.
        for (
            number,
            Loss {
                reason,
                messages,
                is_shown,
            },
        ) in losses
        {
            self.losses.is_pool_short |= reason == GapReason::Unsent(Fate::PoolLimit);
            let publisher = &mut self.publishers[number];
            lost += match is_shown {
                true => publisher.explain(now, messages, reason),
                false => {
                    publisher.lose(now, messages, reason);
                    messages
                }
            };
        }
        lost += self
            .publishers
            .iter_mut()
            .map(|it| it.count(now))
            .sum::<u64>();
        self.publishers.iter_mut().for_each(|it| it.unexplained = 0);
        lost
    }

    /// Whether messages may be lost without a later message that shows it.
    pub(super) fn may_lose_unnoticed(&self) -> bool {
        let has_lifespan = |it: &Publisher| it.source.offer.lifespan != Period::NONE;
        self.is_reliable || self.losses.is_pool_short || self.publishers.iter().any(has_lifespan)
    }

    /// Passes all gaps to the writer.
    pub(super) fn flush_gaps(&mut self, queue: &Queue) {
        self.publishers
            .iter_mut()
            .for_each(|it| it.flush_gaps(queue));
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
        Publisher::new(source)
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

    /// Looks whether it has, or has had, a link.
    pub(super) fn look_for_link(&mut self) {
        self.was_linked =
            self.was_linked || !self.publishers.is_empty() || !self.subscriber.links().is_empty();
    }

    /// How many publishers the topic has had.
    pub(super) fn publishers(&self) -> usize {
        self.publishers.len()
    }

    /// The message will be in the bag, behind the gaps before it.
    pub(super) fn mark_recorded(&mut self, taken: &Taken, queue: &Queue) {
        let publisher = &mut self.publishers[taken.publisher];
        publisher.flush_gaps(queue);
        publisher.last_time = Some(taken.times.log_time);
    }

    /// The message is dropped for this reason.
    pub(super) fn count_dropped(&mut self, taken: &Taken, reason: GapReason) {
        self.publishers[taken.publisher].lose(taken.times.log_time, 1, reason);
    }

    /// Looks which publishers have left. Returns whether there is one.
    pub(super) fn look_who_left(&mut self) -> bool {
        if self.publishers.is_empty() {
            return false;
        }
        let links = self.subscriber.links();
        for it in &mut self.publishers {
            let Source {
                publisher, data, ..
            } = &*it.source;
            let mut open = links.iter().filter(|it| it.open);
            let is_there = open.any(|it| offer_of(&it.peer, publisher, data).is_some());
            it.left = (!is_there).then(|| it.left.unwrap_or(self.emptied));
        }
        self.has_left()
    }

    /// Whether a publisher is known that has left.
    pub(super) fn has_left(&self) -> bool {
        self.publishers.iter().any(|it| it.left.is_some())
    }

    /// Forgets the publishers that have left, if all of their messages were taken: until then, their numbers show
    /// losses that may have been counted before. There may be very many publishers, one after the other. Returns those
    /// that are latched. One that comes back is described again, and sends its latched messages again.
    pub(super) fn take_left(&mut self, queue: &Queue) -> Vec<Arc<Source>> {
        let emptied = self.emptied;
        let is_over = |it: &mut Publisher| it.left.is_some_and(|left| left < emptied);
        let left = self.publishers.extract_if(.., is_over);
        let flushed = left.map(|mut it| {
            it.flush_gaps(queue);
            it
        });
        let latched = flushed.filter(|it| it.source.offer.latched > 0);
        let left = latched.map(|it| it.source).collect();
        self.was_linked = true;
        left
    }

    /// Logs that a message is left out because of its length. Names the topic once.
    pub(super) fn log_too_long(&mut self, len_bytes: u64) {
        if !std::mem::replace(&mut self.losses.has_logged_too_long, true) {
            let topic = self.subscriber.topic();
            tracing::error!(%topic, len_bytes, "messages are left out: they are longer than the recorder takes");
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
