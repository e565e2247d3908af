//! A domain with indexes for commands: its links by interface, and its names by kind.

use std::collections::{BTreeMap, BTreeSet};

use sm2_proto::{
    Contract, EntityId, Kind, Name, NodeId, TypeId,
    domain::{Domain, InterfaceView, LinkView},
};

/// A domain at one revision, with an index from interfaces to links.
#[derive(Clone, Debug)]
pub(crate) struct View<'a> {
    pub(crate) domain: &'a Domain,
    links: BTreeMap<EntityId, Vec<LinkView>>,
}

impl<'a> View<'a> {
    pub(crate) fn new(domain: &'a Domain) -> Self {
        let mut links: BTreeMap<_, Vec<_>> = BTreeMap::new();
        for link in domain.links() {
            links.entry(link.offering).or_default().push(link);
            if link.demanding != link.offering {
                links.entry(link.demanding).or_default().push(link);
            }
        }
        Self { domain, links }
    }

    /// The links of an interface.
    pub(crate) fn links_of(&self, entity: EntityId) -> &[LinkView] {
        self.links.get(&entity).map_or(&[], Vec::as_slice)
    }

    /// The name of a node, or `?` if the node is gone.
    pub(crate) fn name_of(&self, node: NodeId) -> &'a str {
        self.domain
            .node(node)
            .map_or("?", |node| node.name.as_str())
    }

    /// The title of an interface, such as `talker:chatter`. The title of a node is its name.
    pub(crate) fn title(&self, entity: EntityId) -> String {
        let node = self.name_of(entity.node);
        match self.domain.interface(entity) {
            Some(it) => format!("{node}:{}", it.contract.name()),
            None => node.to_owned(),
        }
    }

    /// The granted interfaces.
    pub(crate) fn granted(&self) -> impl Iterator<Item = InterfaceView<'a>> + use<'a> {
        self.domain.interfaces().filter(|it| it.refused.is_none())
    }

    /// The granted interfaces of these kinds on a topic or service.
    pub(crate) fn on(
        &self,
        name: &Name,
        kinds: &[Kind],
    ) -> impl Iterator<Item = InterfaceView<'a>> {
        self.granted()
            .filter(move |it| it.contract.name() == name && kinds.contains(&it.contract.kind()))
    }

    /// The names of all topics, or of all services, that have an interface.
    pub(crate) fn names(&self, kinds: &[Kind]) -> BTreeSet<&'a Name> {
        let all = self.granted().map(|it| it.contract);
        let of_kind = all.filter(|it| kinds.contains(&it.kind()));
        of_kind.map(Contract::name).collect()
    }

    /// The granted interfaces of all topics, or of all services, by name.
    pub(crate) fn by_name(&self, kinds: &[Kind]) -> BTreeMap<&'a Name, Vec<InterfaceView<'a>>> {
        let mut all: BTreeMap<_, Vec<_>> = BTreeMap::new();
        for it in self
            .granted()
            .filter(|it| kinds.contains(&it.contract.kind()))
        {
            all.entry(it.contract.name()).or_default().push(it);
        }
        all
    }

    /// The number of links between interfaces of one topic or service. Each link has one publisher or server.
    pub(crate) fn links_from(&self, interfaces: &[InterfaceView<'_>]) -> usize {
        let offers =
            |it: &&InterfaceView<'_>| matches!(it.contract.kind(), Kind::Publisher | Kind::Server);
        let offering = interfaces.iter().filter(offers);
        offering.map(|it| self.links_of(it.entity).len()).sum()
    }

    /// The type of a topic, if an interface has stated one.
    pub(crate) fn topic_type(&self, topic: &Name) -> Option<&'a TypeId> {
        self.on(topic, TOPIC).find_map(|it| topic_type(it.contract))
    }

    /// The types of a service's requests and replies, if an interface has stated them.
    pub(crate) fn service_types(&self, service: &Name) -> Option<[&'a TypeId; 2]> {
        self.on(service, SERVICE)
            .find_map(|it| service_types(it.contract))
    }
}

/// The type of messages that a publisher or subscriber has stated.
pub(crate) const fn topic_type(contract: &Contract) -> Option<&TypeId> {
    match contract {
        Contract::Publisher { data, .. } => Some(data),
        Contract::Subscriber { data, .. } => data.as_ref(),
        Contract::Server { .. } | Contract::Client { .. } => None,
    }
}

/// The types of requests and replies that a server or client has stated.
pub(crate) fn service_types(contract: &Contract) -> Option<[&TypeId; 2]> {
    match contract {
        Contract::Server { request, reply, .. } => Some([request, reply]),
        Contract::Client { types, .. } => types.as_ref().map(|(request, reply)| [request, reply]),
        Contract::Publisher { .. } | Contract::Subscriber { .. } => None,
    }
}

/// The number of interfaces of one kind.
pub(crate) fn count(interfaces: &[InterfaceView<'_>], kind: Kind) -> usize {
    let of_kind = interfaces.iter().filter(|it| it.contract.kind() == kind);
    of_kind.count()
}

/// The kinds of interfaces that topics have.
pub(crate) const TOPIC: &[Kind] = &[Kind::Publisher, Kind::Subscriber];

/// The kinds of interfaces that services have.
pub(crate) const SERVICE: &[Kind] = &[Kind::Server, Kind::Client];
