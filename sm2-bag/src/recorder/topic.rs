//! One topic of a recording.

use std::collections::HashMap;
use std::sync::Arc;

use sm2_node::domain::Contract;
use sm2_node::wait_set::Key;
use sm2_node::{Node, Sample, Subscriber};
use sm2_proto::{Name, OfferedQos, Period, TypeId};

use crate::clock::ClockRelation;
use crate::gap::{Gap, GapReason};
use crate::source::Source;
use crate::writer::MessageTimes;

/// The QoS in the bag of a publisher that is gone before its first message was taken.
const UNKNOWN_OFFER: OfferedQos = OfferedQos {
    depth: 1,
    reliable: false,
    latched: 0,
    sealed: false,
    deadline: Period::NONE,
    lifespan: Period::NONE,
    lease: Period::NONE,
};

/// A topic that is recorded, and its publishers.
pub(super) struct Topic {
    pub(super) subscriber: Subscriber<[u8]>,
    /// The place of the subscriber in the wait set; `None` while the queue has no room for this reliable topic.
    pub(super) key: Option<Key>,
    /// Whether its publishers wait when the queue has no room.
    pub(super) is_reliable: bool,
    publishers: HashMap<(Name, TypeId), Publisher>,
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
    key: (Name, TypeId),
}

impl Topic {
    pub(super) fn new(subscriber: Subscriber<[u8]>, key: Key, is_reliable: bool) -> Self {
        Self {
            subscriber,
            key: Some(key),
            is_reliable,
            publishers: HashMap::new(),
        }
    }

    /// Describes a message that was taken at `now`, a time of the wall clock. `None` if its sender is no publisher,
    /// which the Manager never links.
    pub(super) fn note(
        &mut self,
        node: &Node,
        sample: &Sample<[u8]>,
        clock: &ClockRelation,
        now: u64,
    ) -> Option<Taken> {
        let key = (sample.publisher().clone(), sample.type_id()?.clone());
        if !self.publishers.contains_key(&key) {
            let publisher = self.publisher(node, &key);
            self.publishers.insert(key.clone(), publisher);
        }
        let Publisher { source, last_time } = self.publishers.get(&key)?;
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
            key,
        })
    }

    /// Describes the publisher of a message.
    fn publisher(&self, node: &Node, (name, data): &(Name, TypeId)) -> Publisher {
        let links = self.subscriber.links();
        let offer = links.iter().find_map(|link| match &link.peer.contract {
            Contract::Publisher {
                data: its, offer, ..
            } if its == data && link.peer.name == *name => Some(*offer),
            _ => None,
        });
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

    /// How many publishers the topic has had.
    pub(super) fn publishers(&self) -> usize {
        self.publishers.len()
    }

    /// The message will be in the bag.
    pub(super) fn note_recorded(&mut self, taken: &Taken) {
        if let Some(publisher) = self.publishers.get_mut(&taken.key) {
            publisher.last_time = Some(taken.times.log_time);
        }
    }

    /// The gap that a message leaves for which there is no memory.
    pub(super) fn dropped(&self, taken: &Taken) -> Gap {
        let last = self.publishers.get(&taken.key).and_then(|it| it.last_time);
        Gap {
            publisher: taken.source.publisher.to_string(),
            from_ns: last.unwrap_or(taken.times.log_time),
            to_ns: taken.times.log_time,
            messages: 1,
            reason: GapReason::Budget,
        }
    }
}
