//! The publishers of a player.

use std::collections::{BTreeSet, HashMap};

use sm2_node::{ConnectError, DeclareError, Node, Publisher, clock};
use sm2_proto::Name;

use super::options::{LeftOut, PlayOptions};
use crate::bag::Bag;
use crate::error::PlayError;
use crate::source::Source;

/// A publisher, and the number of messages that it has published.
pub(super) struct Played {
    pub(super) publisher: Publisher<[u8]>,
    pub(super) messages: u64,
}

/// A bag with more nodes than this is played by one node, unless nodes have their original names. Each node is a
/// session, and the Manager allows a few hundred for a process.
const NODES_MAX: usize = 64;
/// The name of the one node, behind the prefix.
const COMMON: &str = "bag";

/// The publishers of the bags.
pub(super) struct Declared {
    /// The nodes, by the name without the prefix.
    pub(super) nodes: HashMap<Name, Node>,
    pub(super) publishers: Vec<Played>,
    /// The publishers by the number of their bag, and the number of their channel in it.
    pub(super) channels: HashMap<(usize, u16), usize>,
    /// Whether a channel is left out because the player publishes domain time itself.
    pub(super) omits_clock: bool,
    pub(super) left_out: Vec<LeftOut>,
    /// The number of nodes in the bags, if one node publishes for all of them.
    pub(super) merged_nodes: Option<usize>,
}

/// A channel that is played: the number of its bag, its own number, and its publisher.
type Channel = (usize, u16, Source);

impl Declared {
    /// Declares one publisher for each recorded one, also if it is in several bags. If there are very many, one is
    /// declared for all that have the same topic, type and QoS. Channels whose messages would be a second source of
    /// domain time are left out.
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
            left_out: Vec::new(),
            merged_nodes: None,
        };
        let played = declared.choose(bags, options)?;
        let nodes: BTreeSet<_> = played.iter().map(|it| &it.2.publisher).collect();
        if nodes.len() > NODES_MAX && !options.original_names {
            declared.merged_nodes = Some(nodes.len());
        }
        let mut known = HashMap::new();
        for (bag, channel, mut source) in played {
            let mut offer = None;
            if declared.merged_nodes.is_some() {
                source.publisher = Name::new(COMMON).expect("a legal name");
                offer = Some(source.offer);
            }
            let (topic, publisher) = (source.topic.clone(), source.publisher.clone());
            let key = (topic, publisher, source.data.clone(), offer);
            let number = match known.get(&key) {
                Some(it) => *it,
                None => {
                    let topic = source.topic.to_string();
                    let publisher = match declared.declare(source, options, connect) {
                        Err(PlayError::Declare(error @ DeclareError::TypeMismatch { .. })) => {
                            declared.leave_out(topic, &error);
                            continue;
                        }
                        publisher => publisher?,
                    };
                    let number = declared.publishers.len();
                    let messages = 0;
                    (declared.publishers).push(Played {
                        publisher,
                        messages,
                    });
                    known.insert(key, number);
                    number
                }
            };
            declared.channels.insert((bag, channel), number);
        }
        Ok(declared)
    }

    /// Reports that a topic is not played, because its type in the domain is another one.
    fn leave_out(&mut self, topic: String, error: &DeclareError) {
        let reason = error.to_string();
        let left_out = LeftOut { topic, reason };
        if !self.left_out.contains(&left_out) {
            tracing::error!(topic = left_out.topic, %error, "the topic is not played");
            self.left_out.push(left_out);
        }
    }

    /// The channels that are played.
    fn choose(&mut self, bags: &[Bag], options: &PlayOptions) -> Result<Vec<Channel>, PlayError> {
        let mut played = Vec::new();
        for (number, bag) in bags.iter().enumerate() {
            for (channel, source) in bag.sources() {
                if !options.filter.has_topic(&channel.topic) {
                    continue;
                }
                let published = options.published_topic(&channel.topic);
                if options.is_clock_source() && published == clock::TOPIC {
                    self.omits_clock = true;
                    continue;
                }
                let source = source.map_err(|reason| PlayError::Foreign {
                    path: bag.path().to_owned(),
                    topic: channel.topic.clone(),
                    reason: Box::new(reason),
                })?;
                played.push((number, channel.id, source));
            }
        }
        Ok(played)
    }

    /// Declares the publisher of a recorded one, in the node of its name.
    fn declare(
        &mut self,
        mut source: Source,
        options: &PlayOptions,
        connect: &mut impl FnMut(&str) -> Result<Node, ConnectError>,
    ) -> Result<Publisher<[u8]>, PlayError> {
        source.offer.reliable |= options.lockstep.is_some();
        let name = &source.publisher;
        if !self.nodes.contains_key(name) {
            let connected = connect(&options.node_name(name.as_str()))?;
            self.nodes.insert(name.clone(), connected);
        }
        let topic = options.published_topic(source.topic.as_str());
        Ok(declare(&self.nodes[name], &topic, &source)?)
    }
}

/// Declares the publisher of a recorded one.
fn declare(node: &Node, topic: &str, source: &Source) -> Result<Publisher<[u8]>, DeclareError> {
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
    builder.declare()
}
