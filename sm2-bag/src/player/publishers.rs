//! The publishers of a player.

use std::collections::HashMap;

use sm2_node::{ConnectError, Node, Publisher, clock};
use sm2_proto::Name;

use super::options::PlayOptions;
use crate::bag::Bag;
use crate::error::PlayError;
use crate::source::Source;

/// A publisher, and the number of messages that it has published.
pub(super) struct Played {
    pub(super) publisher: Publisher<[u8]>,
    pub(super) messages: u64,
}

/// The publishers of the bags.
pub(super) struct Declared {
    /// The nodes, by the recorded name.
    pub(super) nodes: HashMap<Name, Node>,
    pub(super) publishers: Vec<Played>,
    /// The publishers by the number of their bag, and the number of their channel in it.
    pub(super) channels: HashMap<(usize, u16), usize>,
    /// Whether a channel is left out because the player publishes domain time itself.
    pub(super) omits_clock: bool,
}

impl Declared {
    /// Declares one publisher for each recorded one, also if it is in several bags. Channels whose messages would be a
    /// second source of domain time are left out.
    pub(super) fn new(
        bags: &[Bag],
        options: &PlayOptions,
        connect: &mut impl FnMut(&str) -> Result<Node, ConnectError>,
    ) -> Result<Self, PlayError> {
        let mut declared = Self {
            nodes: HashMap::new(),
            publishers: Vec::new(),
            channels: HashMap::new(),
            omits_clock: false,
        };
        let mut known = HashMap::new();
        let all = bags.iter().enumerate();
        for (number, channel, source) in
            all.flat_map(|(number, bag)| bag.sources().map(move |it| (number, it.0, it.1)))
        {
            if !options.filter.has_topic(&channel.topic) {
                continue;
            }
            if options.is_clock_source() && options.published_topic(&channel.topic) == clock::TOPIC
            {
                declared.omits_clock = true;
                continue;
            }
            let source = source.map_err(|reason| PlayError::Foreign {
                path: bags[number].path().to_owned(),
                topic: channel.topic.clone(),
                reason: Box::new(reason),
            })?;
            let Source {
                topic,
                publisher,
                data,
                ..
            } = &source;
            let key = (topic.clone(), publisher.clone(), data.clone());
            if !known.contains_key(&key) {
                if !declared.nodes.contains_key(publisher) {
                    let name = format!("{}{publisher}", options.prefix());
                    declared.nodes.insert(publisher.clone(), connect(&name)?);
                }
                let topic = options.published_topic(topic.as_str());
                known.insert(key.clone(), declared.publishers.len());
                let mut source = source.clone();
                source.offer.reliable |= options.lockstep.is_some();
                declared.publishers.push(Played {
                    publisher: declare(&declared.nodes[publisher], topic, &source)?,
                    messages: 0,
                });
            }
            declared.channels.insert((number, channel.id), known[&key]);
        }
        Ok(declared)
    }
}

/// Declares the publisher of a recorded one.
fn declare(node: &Node, topic: &str, source: &Source) -> Result<Publisher<[u8]>, PlayError> {
    if let Some(text) = &source.schema {
        // A text that does not fit its type only costs tools the names of the fields.
        if let Err(error) = node.register_schema(source.data.clone(), text) {
            tracing::warn!(topic, %error, "the bag has a schema that does not fit its type");
        }
    }
    let offer = source.offer;
    let mut builder = node
        .publisher_builder::<[u8]>(topic)
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
