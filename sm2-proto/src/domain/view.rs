//! The nodes, interfaces and links of a domain.

use alloc::vec::Vec;

use super::Domain;
use crate::{
    Contract, EntityId, InterfaceId, LinkId, Name, NodeId, Refusal,
    control::{Item, Key, StatedLimits, UnlinkedReason},
};

/// A node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeView<'a> {
    /// Its number.
    pub node: NodeId,
    /// Its name.
    pub name: &'a Name,
    /// Its user, as the kernel says.
    pub uid: u32,
    /// Its process, as the kernel says.
    pub pid: i32,
    /// Whether it is still claiming links of an earlier Manager.
    pub resuming: bool,
    /// The number of ends of links that it can have at a time, if it stated one.
    pub max_links: Option<u32>,
}

/// An interface, granted or refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct InterfaceView<'a> {
    /// The id.
    pub entity: EntityId,
    /// The contract, granted or refused.
    pub contract: &'a Contract,
    /// The reason of the refusal, if it was refused.
    pub refused: Option<&'a Refusal>,
}

/// A link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LinkView {
    /// Its number.
    pub link: LinkId,
    /// The publisher or server.
    pub offering: EntityId,
    /// The subscriber or client.
    pub demanding: EntityId,
    /// The protocol version of the link.
    pub version: u16,
    /// Whether no message may be displaced.
    pub reliable: bool,
    /// Whether every message is inline or sealed.
    pub sealed: bool,
}

impl LinkView {
    /// Whether one of its ends is this interface.
    #[must_use]
    pub fn touches(&self, entity: EntityId) -> bool {
        self.offering == entity || self.demanding == entity
    }
}

impl Domain {
    /// The public part of the operator's policy, if the Manager has sent it.
    #[must_use]
    pub fn limits(&self) -> Option<&StatedLimits> {
        match self.get(&Key::Domain)? {
            Item::Domain { limits } => Some(limits),
            _ => None,
        }
    }

    /// All nodes in the order of their numbers.
    pub fn nodes(&self) -> impl Iterator<Item = NodeView<'_>> {
        self.items().filter_map(as_node)
    }

    /// One node.
    #[must_use]
    pub fn node(&self, node: NodeId) -> Option<NodeView<'_>> {
        let entity = EntityId::node(node);
        self.get(&Key::Member { entity }).and_then(as_node)
    }

    /// The node of this name.
    #[must_use]
    pub fn node_named(&self, name: &str) -> Option<NodeView<'_>> {
        self.nodes().find(|node| node.name.as_str() == name)
    }

    /// All interfaces, granted or refused, in the order of their ids.
    pub fn interfaces(&self) -> impl Iterator<Item = InterfaceView<'_>> {
        self.items().filter_map(as_interface)
    }

    /// The interfaces of one node.
    pub fn interfaces_of(&self, node: NodeId) -> impl Iterator<Item = InterfaceView<'_>> {
        let key = |interface| Key::Member {
            entity: EntityId {
                node,
                interface: InterfaceId(interface),
            },
        };
        let of_node = self.items.range(key(0)..=key(u64::MAX));
        of_node.filter_map(|(_, item)| as_interface(item))
    }

    /// One interface.
    #[must_use]
    pub fn interface(&self, entity: EntityId) -> Option<InterfaceView<'_>> {
        self.get(&Key::Member { entity }).and_then(as_interface)
    }

    /// All links in the order of their numbers.
    pub fn links(&self) -> impl Iterator<Item = LinkView> {
        self.items().filter_map(as_link)
    }

    /// The links that no node was told of yet, because one of the two nodes has no room: the link,
    /// the publisher or server, and the subscriber or client.
    pub fn waiting_links(&self) -> impl Iterator<Item = (LinkId, EntityId, EntityId)> {
        self.items().filter_map(|item| match *item {
            Item::Waiting {
                link,
                offering,
                demanding,
            } => Some((link, offering, demanding)),
            _ => None,
        })
    }

    /// How many ends of links a node has that it knows: those of links, and its claims.
    #[must_use]
    pub fn known_ends(&self, node: NodeId) -> u32 {
        let links = self.links().flat_map(|it| [it.offering, it.demanding]);
        let claims = self.claims().map(|(_, entity)| entity);
        let ends = links.chain(claims).filter(|it| it.node == node).count();
        u32::try_from(ends).unwrap_or(u32::MAX)
    }

    /// The links of one interface. A link that joins it with itself comes once.
    pub fn links_of(&self, entity: EntityId) -> impl Iterator<Item = LinkView> {
        self.links().filter(move |link| link.touches(entity))
    }

    /// The links of an earlier Manager that only one end has claimed, and that end.
    pub fn claims(&self) -> impl Iterator<Item = (LinkId, EntityId)> {
        self.items().filter_map(|item| match *item {
            Item::Claim { link, entity } => Some((link, entity)),
            _ => None,
        })
    }

    /// The reason why two interfaces that match are not linked, if the Manager has stated one. The
    /// publisher or server comes first.
    #[must_use]
    pub fn unlinked_reason(
        &self,
        offering: EntityId,
        demanding: EntityId,
    ) -> Option<UnlinkedReason> {
        let key = Key::Unlinked {
            offering,
            demanding,
        };
        match self.get(&key)? {
            Item::Unlinked { reason, .. } => Some(*reason),
            _ => None,
        }
    }

    /// The interfaces that a person names with `node:topic`, with `topic` alone, or with `node`
    /// alone if no topic or service has that name. One leading `/` of each name is dropped.
    #[must_use]
    pub fn find(&self, text: &str) -> Vec<EntityId> {
        if let Some((node, name)) = text.split_once(':') {
            let (node, name) = (plain(node), plain(name));
            return self.node_named(node).map_or_else(Vec::new, |node| {
                let of_node = self.interfaces_of(node.node);
                let named = of_node.filter(|it| it.contract.name().as_str() == name);
                named.map(|it| it.entity).collect()
            });
        }
        let text = plain(text);
        let named = self.interfaces();
        let named = named.filter(|it| it.contract.name().as_str() == text);
        let entities: Vec<_> = named.map(|it| it.entity).collect();
        match self.node_named(text) {
            Some(node) if entities.is_empty() => {
                self.interfaces_of(node.node).map(|it| it.entity).collect()
            }
            _ => entities,
        }
    }
}

const fn as_node(item: &Item) -> Option<NodeView<'_>> {
    match item {
        Item::Node {
            node,
            name,
            uid,
            pid,
            resuming,
            max_links,
        } => Some(NodeView {
            node: *node,
            name,
            uid: *uid,
            pid: *pid,
            resuming: *resuming,
            max_links: *max_links,
        }),
        _ => None,
    }
}

const fn as_interface(item: &Item) -> Option<InterfaceView<'_>> {
    match item {
        Item::Interface { entity, contract } => Some(InterfaceView {
            entity: *entity,
            contract,
            refused: None,
        }),
        Item::Refusal {
            entity,
            contract,
            reason,
        } => Some(InterfaceView {
            entity: *entity,
            contract,
            refused: Some(reason),
        }),
        _ => None,
    }
}

const fn as_link(item: &Item) -> Option<LinkView> {
    match item {
        Item::Link {
            link,
            offering,
            demanding,
            version,
            reliable,
            sealed,
        } => Some(LinkView {
            link: *link,
            offering: *offering,
            demanding: *demanding,
            version: *version,
            reliable: *reliable,
            sealed: *sealed,
        }),
        _ => None,
    }
}

fn plain(typed: &str) -> &str {
    typed.strip_prefix('/').unwrap_or(typed)
}
