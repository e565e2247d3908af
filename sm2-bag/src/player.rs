//! Publishing the messages of bags again.

use std::collections::{BTreeMap, HashMap};
use std::os::fd::BorrowedFd;
use std::path::PathBuf;
use std::time::Duration;

use serde::Serialize;
use sm2_node::wait_set::Interest;
use sm2_node::{ConnectError, Node, Publisher, WaitSet};
use sm2_proto::{Instant, Name};

use crate::bag::Bag;
use crate::error::PlayError;
use crate::merged::Merged;
use crate::messages::Filter;
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

/// Publishes the messages of one or more bags in the order and at the pace of their `log_time`.
///
/// Each recorded publisher has a publisher with the same type and QoS, in a node of its own name. Before the first
/// message, the player waits until the subscribers that the domain has are linked.
pub struct Player<'a> {
    bags: &'a [Bag],
    options: PlayOptions,
    publishers: Vec<Played>,
    /// The publishers by the number of their bag, and the number of their channel in it.
    channels: HashMap<(usize, u16), usize>,
    set: WaitSet<'a, ()>,
    /// The nodes of the publishers.
    _nodes: HashMap<Name, Node>,
}

struct Played {
    publisher: Publisher<[u8]>,
    messages: u64,
}

impl<'a> Player<'a> {
    /// Declares the publishers. A publisher that is in several bags is declared once, with the QoS of the first one.
    /// `connect` returns a node of a name. The descriptor `stop` ends [`play`](Self::play) when it is readable.
    ///
    /// # Errors
    ///
    /// See [`PlayError`].
    pub fn new(
        bags: &'a [Bag],
        options: PlayOptions,
        mut connect: impl FnMut(&str) -> Result<Node, ConnectError>,
        stop: BorrowedFd<'a>,
    ) -> Result<Self, PlayError> {
        let mut nodes = HashMap::new();
        let mut publishers = Vec::new();
        let mut known = HashMap::new();
        let mut channels = HashMap::new();
        let all = bags.iter().enumerate();
        for (number, channel, source) in
            all.flat_map(|(number, bag)| bag.sources().map(move |it| (number, it.0, it.1)))
        {
            if !options.filter.has_topic(&channel.topic) {
                continue;
            }
            let foreign = || PlayError::Foreign {
                path: bags[number].path().to_owned(),
                topic: channel.topic.clone(),
            };
            let source = source.ok_or_else(foreign)?;
            let Source {
                topic,
                publisher,
                data,
                ..
            } = &source;
            let key = (topic.clone(), publisher.clone(), data.clone());
            if !known.contains_key(&key) {
                if !nodes.contains_key(publisher) {
                    let prefix = if options.original_names { "" } else { "play/" };
                    nodes.insert(publisher.clone(), connect(&format!("{prefix}{publisher}"))?);
                }
                let topic = options.remap.get(topic).unwrap_or(topic);
                known.insert(key.clone(), publishers.len());
                publishers.push(Played {
                    publisher: declare(&nodes[publisher], topic, &source)?,
                    messages: 0,
                });
            }
            channels.insert((number, channel.id), known[&key]);
        }
        if publishers.is_empty() {
            let path = first_path(bags);
            return Err(PlayError::Empty { path });
        }
        let mut set = WaitSet::new().map_err(sm2_node::WaitError::Io)?;
        let added = set.add_descriptor(stop, Interest::Readable, ());
        added.map_err(sm2_node::WaitError::Io)?;
        Ok(Self {
            bags,
            options,
            publishers,
            channels,
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
        for message in Merged::new(self.bags, &self.options.filter)? {
            let (bag, message) = message?;
            let (began, first) = *start.get_or_insert((sm2_io::clock::now(), message.log_time));
            let due = self.due(began, message.log_time.saturating_sub(first));
            let publisher = self.channels.get(&(bag, message.channel.id)).copied();
            if !self.wait_until(due)? || !self.publish(publisher, &message.data)? {
                return Ok(self.report(false));
            }
            count += 1;
        }
        if count == 0 {
            let path = first_path(self.bags);
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
            if !self.publishers.iter().any(lacks) {
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
    fn publish(&mut self, publisher: Option<usize>, data: &[u8]) -> Result<bool, PlayError> {
        let until = sm2_io::clock::now().after(self.options.room_timeout);
        loop {
            let Some(played) = publisher.and_then(|it| self.publishers.get_mut(it)) else {
                return Ok(true);
            };
            if played.publisher.try_publish(data)?.is_some() {
                played.messages += 1;
                return Ok(true);
            }
            if sm2_io::clock::now() >= until {
                played.publisher.publish_timeout(data, Duration::ZERO)?;
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
        for played in &self.publishers {
            let left = until.since(sm2_io::clock::now());
            flushed &= played.publisher.flush_timeout(left)?;
        }
        Ok(flushed)
    }

    fn report(&self, complete: bool) -> PlayReport {
        let mut topics = BTreeMap::<_, PlayedTopic>::new();
        for played in &self.publishers {
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

/// The path that errors name.
fn first_path(bags: &[Bag]) -> PathBuf {
    bags.first()
        .map(|it| it.path().to_owned())
        .unwrap_or_default()
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
