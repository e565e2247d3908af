//! The items of a domain, as PAGE and CHANGES show them. The order of variants and fields is the
//! wire format, and the order of [`Key`] is the order of the items.

use serde::{Deserialize, Serialize};

use super::stated_limits::StatedLimits;
use crate::{Code, Contract, EntityId, InterfaceId, LinkId, Name, NodeId, Refusal};

/// An item of the domain.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Item {
    /// The domain itself.
    Domain {
        /// The public part of the operator's policy.
        limits: StatedLimits,
    },
    /// A node.
    Node {
        /// Its number.
        node: NodeId,
        /// Its name.
        name: Name,
        /// Its user, as the kernel says.
        uid: u32,
        /// Its process, as the kernel says.
        pid: i32,
        /// Whether the node is still claiming links of an earlier Manager.
        resuming: bool,
        /// The number of ends of links that the node can have at a time, if it stated one
        /// (SM2-LNK-007).
        max_links: Option<u32>,
    },
    /// An interface.
    Interface {
        /// The id of the interface.
        entity: EntityId,
        /// The contract.
        contract: Contract,
    },
    /// An interface that was refused (SM2-WCH-004).
    Refusal {
        /// The number that was spent on it.
        entity: EntityId,
        /// The contract that was refused.
        contract: Contract,
        /// The reason.
        reason: Refusal,
    },
    /// A link.
    Link {
        /// Its number.
        link: LinkId,
        /// The publisher or server.
        offering: EntityId,
        /// The subscriber or client.
        demanding: EntityId,
        /// The protocol version of the link.
        version: u16,
        /// Whether no message may be displaced.
        reliable: bool,
        /// Whether every message is inline or sealed.
        sealed: bool,
    },
    /// A link of an earlier Manager that one end has claimed, and the other has not yet.
    Claim {
        /// Its number.
        link: LinkId,
        /// The end that claimed it.
        entity: EntityId,
    },
    /// Two interfaces that match and are not linked (SM2-WCH-004).
    Unlinked {
        /// The publisher or server.
        offering: EntityId,
        /// The subscriber or client.
        demanding: EntityId,
        /// The reason.
        reason: UnlinkedReason,
    },
    /// A link that neither node was told of yet, because one of them has no room for it
    /// (SM2-LNK-006, SM2-LNK-007).
    Waiting {
        /// Its number.
        link: LinkId,
        /// The publisher or server.
        offering: EntityId,
        /// The subscriber or client.
        demanding: EntityId,
    },
}

/// The key of an item. Items are listed in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Key {
    /// The domain itself.
    Domain,
    /// A node (interface 0), an interface, or a refusal.
    Member {
        /// The id.
        entity: EntityId,
    },
    /// A link. The number alone does not identify one: a process that invents two claims may choose
    /// a number that another link has (SM2-RES-004).
    Link {
        /// Its number.
        link: LinkId,
        /// The publisher or server.
        offering: EntityId,
    },
    /// A claim.
    Claim {
        /// The link's number.
        link: LinkId,
        /// The end that claimed it.
        entity: EntityId,
    },
    /// Two interfaces that match and are not linked.
    Unlinked {
        /// The publisher or server.
        offering: EntityId,
        /// The subscriber or client.
        demanding: EntityId,
    },
}

/// The reason why two interfaces that match are not linked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum UnlinkedReason {
    /// One of them ended their link.
    Ended {
        /// The code that the link ended with.
        code: Code,
    },
    /// A node has used up its quota of links.
    Quota {
        /// The node.
        node: NodeId,
        /// The quota.
        limit: u32,
    },
    /// The Manager had no descriptors for a link.
    Descriptors,
}

/// A change of an item.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Change {
    /// The item is new, or has changed.
    Set {
        /// The item as it is now.
        item: Item,
    },
    /// The item is gone.
    Removed {
        /// The key of the item.
        key: Key,
    },
}

impl Item {
    /// The key of this item.
    #[must_use]
    pub const fn key(&self) -> Key {
        match self {
            Self::Domain { .. } => Key::Domain,
            Self::Node { node, .. } => Key::Member {
                entity: EntityId {
                    node: *node,
                    interface: InterfaceId(0),
                },
            },
            Self::Interface { entity, .. } | Self::Refusal { entity, .. } => {
                Key::Member { entity: *entity }
            }
            Self::Link { link, offering, .. } | Self::Waiting { link, offering, .. } => Key::Link {
                link: *link,
                offering: *offering,
            },
            Self::Claim { link, entity } => Key::Claim {
                link: *link,
                entity: *entity,
            },
            Self::Unlinked {
                offering,
                demanding,
                ..
            } => Key::Unlinked {
                offering: *offering,
                demanding: *demanding,
            },
        }
    }

    /// The interface's contract, granted or not.
    #[must_use]
    pub const fn contract(&self) -> Option<&Contract> {
        match self {
            Self::Interface { contract, .. } | Self::Refusal { contract, .. } => Some(contract),
            _ => None,
        }
    }
}
