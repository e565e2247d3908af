//! Publishing the messages of a bag again.

use std::collections::{BTreeMap, HashMap};
use std::os::fd::BorrowedFd;
use std::time::Duration;

use serde::Serialize;
use sm2_node::wait_set::Interest;
use sm2_node::{ConnectError, Node, Publisher, WaitSet};
use sm2_proto::{Instant, Name};

use crate::bag::Bag;
use crate::error::PlayError;
use crate::messages::{BagMessage, Filter};
use crate::source::Source;

/// A wait for subscribers or for room is cut into steps of this length, so that the caller's descriptor ends it soon.
const STEP: Duration = Duration::from_millis(100);

/// How a bag is played.
#[derive(Clone, Debug)]
pub struct PlayOptions {
    /// The topics and times.
    pub filter: Filter,
    /// The speed: 1 as recorded, 2 twice as fast; 0 as fast as possible. Not negative.
    pub rate: f64,
    /// The names of topics that are published under another name.
    pub remap: BTreeMap<Name, Name>,
    /// Whether nodes have their original names. Otherwise `play/` stands before them.
    pub original_names: bool,
    /// How many subscribers of each topic to wait for before the first message.
    pub subscribers: usize,
    /// How long to wait for reliable subscribers that have no room; 10 s by default.
    pub room_timeout: Duration,
}

impl Default for PlayOptions {
    fn default() -> Self {
        Self {
            filter: Filter::default(),
            rate: 1.0,
            remap: BTreeMap::new(),
            original_names: false,
            subscribers: 0,
            room_timeout: Duration::from_secs(10),
        }
    }
}

/// The result of playing.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PlayReport {
    /// The topics, sorted by name.
    pub topics: Vec<PlayedTopic>,
    /// Whether all messages were published. Otherwise the caller ended it.
    pub complete: bool,
}

/// The counts of one topic that was played.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PlayedTopic {
    /// The topic.
    pub name: String,
    /// The number of messages that were published.
    pub messages: u64,
    /// How many of them were published while no subscriber was linked.
    pub unheard: u64,
    /// How many messages subscribers missed, on all links together.
    pub missed: u64,
}

/// Publishes the messages of a bag in the order and at the pace of their `log_time`.
///
/// Each recorded publisher has a publisher with the same type and QoS, in a node of its own name. Before the first
/// message, the player waits until the subscribers that the domain has are linked.
pub struct Player<'a> {
    bag: &'a Bag,
    options: PlayOptions,
    publishers: HashMap<u16, Played>,
    set: WaitSet<'a, ()>,
    /// The nodes of the publishers.
    _nodes: HashMap<Name, Node>,
}

struct Played {
    publisher: Publisher<[u8]>,
    messages: u64,
}

impl<'a> Player<'a> {
    /// Declares the publishers. `connect` returns a node of a name. The descriptor `stop` ends
    /// [`play`](Self::play) when it is readable.
    ///
    /// # Errors
    ///
    /// See [`PlayError`].
    pub fn new(
        bag: &'a Bag,
        options: PlayOptions,
        mut connect: impl FnMut(&str) -> Result<Node, ConnectError>,
        stop: BorrowedFd<'a>,
    ) -> Result<Self, PlayError> {
        let mut nodes = HashMap::new();
        let mut publishers = HashMap::new();
        for (channel, source) in bag.sources() {
            if !options.filter.has_topic(&channel.topic) {
                continue;
            }
            let foreign = || PlayError::Foreign {
                path: bag.path().to_owned(),
                topic: channel.topic.clone(),
            };
            let source = source.ok_or_else(foreign)?;
            if !nodes.contains_key(&source.publisher) {
                let prefix = if options.original_names { "" } else { "play/" };
                let node = connect(&format!("{prefix}{}", source.publisher))?;
                nodes.insert(source.publisher.clone(), node);
            }
            let node = &nodes[&source.publisher];
            let topic = options.remap.get(&source.topic).unwrap_or(&source.topic);
            let publisher = declare(node, topic, &source)?;
            let played = Played {
                publisher,
                messages: 0,
            };
            publishers.insert(channel.id, played);
        }
        let empty = || PlayError::Empty {
            path: bag.path().to_owned(),
        };
        if publishers.is_empty() {
            return Err(empty());
        }
        let mut set = WaitSet::new().map_err(sm2_node::WaitError::Io)?;
        let added = set.add_descriptor(stop, Interest::Readable, ());
        added.map_err(sm2_node::WaitError::Io)?;
        Ok(Self {
            bag,
            options,
            publishers,
            set,
            _nodes: nodes,
        })
    }

    /// Publishes all messages.
    ///
    /// # Errors
    ///
    /// See [`PlayError`].
    pub fn play(&mut self) -> Result<PlayReport, PlayError> {
        if !self.wait_for_subscribers()? {
            return Ok(self.report(false));
        }
        let mut start = None;
        let mut count = 0;
        for message in self.bag.messages(&self.options.filter)? {
            let message = message?;
            let (began, first) = *start.get_or_insert((sm2_io::clock::now(), message.log_time));
            let due = self.due(began, message.log_time.saturating_sub(first));
            if !self.wait_until(due)? || !self.publish(&message)? {
                return Ok(self.report(false));
            }
            count += 1;
        }
        if count == 0 {
            let path = self.bag.path().to_owned();
            return Err(PlayError::Empty { path });
        }
        let complete = self.flush()?;
        Ok(self.report(complete))
    }

    /// The time at which a message is due that was recorded `age_ns` after the first one.
    fn due(&self, began: Instant, age_ns: u64) -> Instant {
        if self.options.rate == 0.0 {
            return began;
        }
        let age = age_ns as f64 / self.options.rate;
        began.after(Duration::from_nanos(age as u64))
    }

    /// Waits until a time. Returns false if the caller ends playing.
    fn wait_until(&mut self, due: Instant) -> Result<bool, PlayError> {
        loop {
            let left = due.since(sm2_io::clock::now());
            if self.set.wait_timeout(left)?.is_some() {
                return Ok(false);
            }
            if due <= sm2_io::clock::now() {
                return Ok(true);
            }
        }
    }

    /// Waits until the subscribers that are there, and those that the options demand, are linked.
    fn wait_for_subscribers(&mut self) -> Result<bool, PlayError> {
        let demanded = self.options.subscribers;
        let until = sm2_io::clock::now().after(self.options.room_timeout);
        loop {
            let lacks = |it: &Played| {
                let open = it.publisher.links().iter().filter(|link| link.open).count();
                let there = match sm2_io::clock::now() < until {
                    true => it.publisher.matched(),
                    false => 0,
                };
                open < demanded.max(there)
            };
            if !self.publishers.values().any(lacks) {
                return Ok(true);
            }
            let soon = sm2_io::clock::now().after(Duration::from_millis(1));
            if !self.wait_until(soon)? {
                return Ok(false);
            }
        }
    }

    /// Publishes a message once every reliable subscriber has room, or at the end of the timeout. Returns false if the
    /// caller ends playing.
    fn publish(&mut self, message: &BagMessage) -> Result<bool, PlayError> {
        let until = sm2_io::clock::now().after(self.options.room_timeout);
        loop {
            let Some(played) = self.publishers.get_mut(&message.channel.id) else {
                return Ok(true);
            };
            if played.publisher.try_publish(&message.data)?.is_some() {
                played.messages += 1;
                return Ok(true);
            }
            if sm2_io::clock::now() >= until {
                played
                    .publisher
                    .publish_timeout(&message.data, Duration::ZERO)?;
                played.messages += 1;
                return Ok(true);
            }
            played.publisher.wait_for_room_timeout(STEP)?;
            if !self.wait_until(Instant(0))? {
                return Ok(false);
            }
        }
    }

    /// Waits until subscribers have received everything, for at most the timeout. Returns false if messages are left.
    fn flush(&mut self) -> Result<bool, PlayError> {
        let until = sm2_io::clock::now().after(self.options.room_timeout);
        let mut flushed = true;
        for played in self.publishers.values() {
            let left = until.since(sm2_io::clock::now());
            flushed &= played.publisher.flush_timeout(left)?;
        }
        Ok(flushed)
    }

    fn report(&self, complete: bool) -> PlayReport {
        let mut topics = BTreeMap::<_, PlayedTopic>::new();
        for played in self.publishers.values() {
            let topic = topics
                .entry(played.publisher.topic().to_string())
                .or_default();
            let counters = played.publisher.counters();
            topic.messages += played.messages;
            topic.unheard += played.publisher.unheard();
            topic.missed += counters.dropped();
        }
        let topics = topics
            .into_iter()
            .map(|(name, it)| PlayedTopic { name, ..it });
        PlayReport {
            topics: topics.collect(),
            complete,
        }
    }
}

/// Declares the publisher of a recorded one.
fn declare(node: &Node, topic: &Name, source: &Source) -> Result<Publisher<[u8]>, PlayError> {
    if let Some(text) = &source.schema {
        // A text that does not fit its type only costs tools the names of the fields.
        if let Err(error) = node.register_schema(source.data.clone(), text) {
            tracing::warn!(%topic, %error, "the bag has a schema that does not fit its type");
        }
    }
    let offer = source.offer;
    let mut builder = node
        .publisher_builder::<[u8]>(topic.as_str())
        .type_id(source.data.clone())
        .depth(offer.depth)
        .reliable(offer.reliable)
        .latched(offer.latched)
        .sealed(offer.sealed);
    // As recorded, so that the same subscribers match. At a slower pace, deadlines are missed.
    if let Some(deadline) = offer.deadline.get() {
        builder = builder.deadline(deadline);
    }
    if let Some(lifespan) = offer.lifespan.get() {
        builder = builder.lifespan(lifespan);
    }
    if let Some(lease) = offer.lease.get() {
        builder = builder.liveliness(lease);
    }
    Ok(builder.declare()?)
}
