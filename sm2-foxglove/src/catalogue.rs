//! The channels and services that viewers see: the topics and services of the domain, as it changes.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
};

use sm2_node::{Node, clock, domain::QueryError};
use sm2_proto::{Contract, Name, TypeId, domain::Domain, gateway::Pattern};

use crate::{
    graph::Graph,
    message_type::{MessageType, MessageTypes},
    protocol,
};

/// The name of the type of the domain's clock (SM2-CLK-001).
const CLOCK_TYPE: &str = "sm2/Clock";

/// A topic with one type.
#[derive(Debug)]
pub(crate) struct Channel {
    pub(crate) id: u64,
    pub(crate) topic: Name,
    pub(crate) data: TypeId,
    pub(crate) message_type: Arc<MessageType>,
    /// The most messages that one of its first publishers keeps for late joiners.
    pub(crate) latched: u16,
}

/// A service with one pair of types.
#[derive(Debug)]
pub(crate) struct Service {
    pub(crate) id: u32,
    pub(crate) name: Name,
    /// The types of requests and replies.
    pub(crate) types: (TypeId, TypeId),
    pub(crate) request: Arc<MessageType>,
    pub(crate) reply: Arc<MessageType>,
}

/// The state of the domain for viewers.
#[derive(Clone, Debug, Default)]
pub(crate) struct Snapshot {
    pub(crate) channels: BTreeMap<u64, Arc<Channel>>,
    pub(crate) services: BTreeMap<u32, Arc<Service>>,
    /// The types of all topics that have a publisher, or a subscriber to messages of one type.
    pub(crate) types: BTreeMap<Name, (TypeId, Arc<MessageType>)>,
    pub(crate) graph: Graph,
    /// Whether the time of the domain is that of a simulation or a replay.
    pub(crate) has_clock: bool,
}

/// Follows the domain.
pub(crate) struct Catalogue {
    node: Node,
    /// The topics that are shown; all of them if there is no pattern.
    patterns: Vec<Pattern>,
    types: MessageTypes,
    /// The last id, of a channel or service. No id is used twice.
    last_id: u32,
    snapshot: Snapshot,
}

impl Catalogue {
    pub(crate) fn new(node: &Node, patterns: Vec<Pattern>) -> Self {
        Self {
            node: node.clone(),
            patterns,
            types: MessageTypes::default(),
            last_id: 0,
            snapshot: Snapshot::default(),
        }
    }

    pub(crate) const fn snapshot(&self) -> &Snapshot {
        &self.snapshot
    }

    /// Takes over the state of the domain.
    ///
    /// # Errors
    ///
    /// See [`QueryError`].
    pub(crate) fn update(&mut self, domain: &Domain) -> Result<(), QueryError> {
        let own = self.node.name().clone();
        let (mut topics, mut services) = (BTreeMap::new(), BTreeSet::new());
        let mut types = BTreeMap::new();
        let mut has_clock = false;
        for interface in domain.interfaces().filter(|it| it.refused.is_none()) {
            if domain
                .node(interface.entity.node)
                .is_none_or(|it| *it.name == own)
            {
                continue;
            }
            match interface.contract {
                Contract::Publisher { topic, data, offer } => {
                    types.insert(topic.clone(), data.clone());
                    has_clock |= topic.as_str() == clock::TOPIC && data.name.as_str() == CLOCK_TYPE;
                    if self.shows(topic) {
                        let latched = topics.entry((topic.clone(), data.clone())).or_insert(0);
                        *latched = offer.latched.max(*latched);
                    }
                }
                Contract::Server {
                    service,
                    request,
                    reply,
                    ..
                } => drop(services.insert((service.clone(), request.clone(), reply.clone()))),
                Contract::Subscriber {
                    topic,
                    data: Some(data),
                    ..
                } => drop(types.entry(topic.clone()).or_insert_with(|| data.clone())),
                Contract::Subscriber { .. } | Contract::Client { .. } => {}
            }
        }
        let known = types.into_iter().map(|(topic, data)| {
            let message_type = self.types.of(&self.node, &data)?;
            Ok((topic, (data, message_type)))
        });
        let types = known.collect::<Result<_, QueryError>>()?;
        self.snapshot = Snapshot {
            channels: self.channels(topics)?,
            services: self.services(services)?,
            types,
            graph: Graph::new(domain, &own),
            has_clock,
        };
        Ok(())
    }

    /// The patterns that match no topic of the domain.
    pub(crate) fn unmatched(&self) -> impl Iterator<Item = &Pattern> {
        let topics = || self.snapshot.channels.values().map(|it| &it.topic);
        (self.patterns.iter()).filter(move |pattern| !topics().any(|it| pattern.fits(it)))
    }

    fn shows(&self, topic: &Name) -> bool {
        self.patterns.is_empty() || self.patterns.iter().any(|it| it.fits(topic))
    }

    fn next_id(&mut self) -> u32 {
        self.last_id += 1;
        self.last_id
    }

    fn channels(
        &mut self,
        topics: BTreeMap<(Name, TypeId), u16>,
    ) -> Result<BTreeMap<u64, Arc<Channel>>, QueryError> {
        let mut channels = BTreeMap::new();
        for ((topic, data), latched) in topics {
            let message_type = self.types.of(&self.node, &data)?;
            let known = self.snapshot.channels.values().find(|it| {
                it.topic == topic && it.data == data && Arc::ptr_eq(&it.message_type, &message_type)
            });
            let channel = match known {
                Some(known) => Arc::clone(known),
                None => Arc::new(Channel {
                    id: self.next_id().into(),
                    topic,
                    data,
                    message_type,
                    latched,
                }),
            };
            channels.insert(channel.id, channel);
        }
        Ok(channels)
    }

    fn services(
        &mut self,
        found: BTreeSet<(Name, TypeId, TypeId)>,
    ) -> Result<BTreeMap<u32, Arc<Service>>, QueryError> {
        let mut services = BTreeMap::new();
        for (name, request, reply) in found {
            let request_type = self.types.of(&self.node, &request)?;
            let reply_type = self.types.of(&self.node, &reply)?;
            let types = (request, reply);
            let known = self.snapshot.services.values().find(|it| {
                it.name == name
                    && it.types == types
                    && Arc::ptr_eq(&it.request, &request_type)
                    && Arc::ptr_eq(&it.reply, &reply_type)
            });
            let service = match known {
                Some(known) => Arc::clone(known),
                None => Arc::new(Service {
                    id: self.next_id(),
                    name,
                    types,
                    request: request_type,
                    reply: reply_type,
                }),
            };
            services.insert(service.id, service);
        }
        Ok(services)
    }
}

impl Channel {
    pub(crate) fn advertisement(&self) -> protocol::Channel<'_> {
        protocol::Channel {
            id: self.id,
            topic: self.topic.as_str(),
            messages: self.message_type.messages(),
        }
    }
}

impl Service {
    pub(crate) fn advertisement(&self) -> protocol::Service<'_> {
        let (request, response) = (self.request.messages(), self.reply.messages());
        // `std_srvs/srv/SetBool_Request` belongs to the service `std_srvs/srv/SetBool`.
        let types = request.schema_name.strip_suffix("_Request");
        protocol::Service {
            id: self.id,
            name: self.name.as_str(),
            types: types.unwrap_or(request.schema_name).to_owned(),
            request,
            response,
        }
    }
}
