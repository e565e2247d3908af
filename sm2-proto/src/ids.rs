//! The ids of sessions, interfaces and links.

use core::fmt;

use serde::{Deserialize, Serialize};

/// A node's session, numbered by its Manager; never used twice in an epoch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct NodeId(pub u64);

/// An interface, numbered by its node; grows within a session, never zero.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct InterfaceId(pub u64);

/// An interface of a node in the domain or, with interface 0, the node itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct EntityId {
    /// The node.
    pub node: NodeId,
    /// The node's number for the interface.
    pub interface: InterfaceId,
}

impl EntityId {
    /// Sorts before every other id.
    pub(crate) const FIRST: Self = Self::node(NodeId(0));

    /// The id of a node itself.
    #[must_use]
    pub const fn node(node: NodeId) -> Self {
        Self {
            node,
            interface: InterfaceId(0),
        }
    }
}

/// A link, numbered by the Manager that made it; never used twice.
//= SM2-LNK-002
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct LinkId {
    /// The Manager that made the link.
    pub epoch: u64,
    /// The Manager's count of its links.
    pub serial: u64,
}

impl LinkId {
    /// Before every other one.
    pub(crate) const FIRST: Self = Self {
        epoch: 0,
        serial: 0,
    };
}

/// A number that only the Manager and the two ends of a link know. An end proves with it that a
/// link is its own when it claims the link from the next Manager (SM2-RES-003).
//= SM2-LNK-002
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct LinkKey(pub u64);

impl fmt::Display for NodeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "node {}", self.0)
    }
}

impl fmt::Display for InterfaceId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "interface {}", self.0)
    }
}

impl fmt::Display for EntityId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of {}", self.interface, self.node)
    }
}

impl fmt::Display for LinkId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "link {:x}.{}", self.epoch, self.serial)
    }
}
