//! What a domain consists of, as PAGE and CHANGES show it. The order of variants and
//! fields is the wire format, and that of [`Key`] the order of the items.

use serde::{Deserialize, Serialize};

use crate::{Code, Contract, EntityId, InterfaceId, LinkId, Name, NodeId, Refusal};

/// One thing in the domain.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Item {
    /// The domain itself.
    Domain {
        /// What the operator allows.
        limits: Limits,
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
        /// Whether it is still claiming links of an earlier Manager.
        resuming: bool,
    },
    /// An interface.
    Interface {
        /// Where it is.
        entity: EntityId,
        /// What it is.
        contract: Contract,
    },
    /// An interface that was not granted (SM2-WCH-004).
    Refusal {
        /// The number that was spent on it.
        entity: EntityId,
        /// What it would have been.
        contract: Contract,
        /// Why not.
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
        /// The version spoken on it.
        version: u16,
        /// Whether nothing on it may be displaced.
        reliable: bool,
        /// Whether every message on it is inline or sealed.
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
        /// Why.
        reason: UnlinkedReason,
    },
}

/// What the operator allows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Limits {
    /// Welcomed sessions of one user.
    pub sessions_per_user: u32,
    /// Interfaces of one session.
    pub interfaces_per_session: u32,
    /// Interfaces of all sessions of one user.
    pub interfaces_per_user: u32,
    /// Ends of links of one session.
    pub links_per_session: u32,
    /// Whether every link of the domain is sealed.
    pub seal_all: bool,
    /// Whether links between different users may be unsealed.
    pub waive_user_boundary: bool,
}

/// Which item. Items are listed in this order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub enum Key {
    /// The domain itself.
    Domain,
    /// A node (interface 0), an interface, or a refusal.
    Member {
        /// Where it is.
        entity: EntityId,
    },
    /// A link. Its number alone would not do: whoever invents two claims may choose one
    /// that others have (SM2-RES-004).
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

/// Why two interfaces that match are not linked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum UnlinkedReason {
    /// One of them ended their link.
    Ended {
        /// Why.
        code: Code,
    },
    /// A node may not have more links.
    Quota {
        /// Which node.
        node: NodeId,
        /// How many it may have.
        limit: u32,
    },
    /// The Manager had no descriptors for a link.
    Descriptors,
}

/// What became of an item.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Change {
    /// It is there, like this.
    Set {
        /// The item.
        item: Item,
    },
    /// It is gone.
    Removed {
        /// Which item.
        key: Key,
    },
}

impl Item {
    /// Which item it is.
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
            Self::Link { link, offering, .. } => Key::Link {
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
