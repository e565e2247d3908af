//! The frames as types. The order of variants and fields is the wire format.

use alloc::vec::Vec;

use serde::{Deserialize, Serialize};

use crate::{Code, Contract, InterfaceId, LinkId, Name, NodeId, Refusal};

/// A frame from a node to its Manager.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ToManager {
    /// The node greets.
    Hello {
        /// The oldest version that it speaks.
        min_version: u16,
        /// The newest version that it speaks.
        max_version: u16,
        /// What it wants to be called.
        name: Name,
    },
    /// The node has a new interface.
    Declare {
        /// The node's number for it.
        interface: InterfaceId,
        /// What it is.
        contract: Contract,
    },
    /// The node drops an interface.
    Withdraw {
        /// Which.
        interface: InterfaceId,
    },
    /// The node's end of a link is gone.
    Unlinked {
        /// Of which interface.
        interface: InterfaceId,
        /// Which link.
        link: LinkId,
        /// Why.
        code: Code,
    },
    /// The node asks for a page of the domain's state.
    Query {
        /// The last item that it knows.
        after: Option<Cursor>,
    },
    /// The node hangs up.
    Goodbye {
        /// Why.
        code: Code,
    },
}

/// A frame from the Manager to a node.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ToNode {
    /// The node is in.
    Welcome {
        /// The version of this session.
        version: u16,
        /// This Manager's incarnation.
        epoch: u64,
        /// The node's number.
        node: NodeId,
    },
    /// The greeting was not granted; the node may greet again.
    HelloRefused {
        /// Why.
        reason: Refusal,
    },
    /// The interface is live.
    Declared {
        /// Which.
        interface: InterfaceId,
        /// How many LINKs for it follow at once.
        matches: u32,
    },
    /// The interface was not granted.
    DeclareRefused {
        /// Which.
        interface: InterfaceId,
        /// Why.
        reason: Refusal,
    },
    /// A link for an interface; one end of its socket pair comes along.
    Link {
        /// The node's interface.
        interface: InterfaceId,
        /// The link.
        link: LinkId,
        /// The version to speak on it.
        version: u16,
        /// Whether nothing on it may be displaced.
        reliable: bool,
        /// Whether every message on it is inline or sealed.
        sealed: bool,
        /// The other side.
        peer: Peer,
    },
    /// A link is over.
    Unlink {
        /// Of which interface.
        interface: InterfaceId,
        /// Which link.
        link: LinkId,
        /// Why.
        code: Code,
    },
    /// The interface is gone.
    Withdrawn {
        /// Which.
        interface: InterfaceId,
    },
    /// A page of the domain's state.
    Page {
        /// Of which revision.
        revision: u64,
        /// Nodes and interfaces in ascending order.
        items: Vec<Item>,
        /// Where to go on, if more follow.
        next: Option<Cursor>,
    },
    /// The Manager hangs up.
    Goodbye {
        /// Why.
        code: Code,
    },
}

/// The other side of a link.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Peer {
    /// Its node.
    pub node: NodeId,
    /// Its node's name.
    pub name: Name,
    /// Its interface.
    pub interface: InterfaceId,
    /// What the interface is.
    pub contract: Contract,
}

/// A position in the domain's state; a node itself counts as interface 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Cursor {
    /// The node.
    pub node: NodeId,
    /// The interface, or 0 for the node itself.
    pub interface: InterfaceId,
}

/// One thing in the domain.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Item {
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
    },
    /// An interface.
    Interface {
        /// Its node.
        node: NodeId,
        /// Its number.
        interface: InterfaceId,
        /// What it is.
        contract: Contract,
        /// How many links it has.
        links: u32,
    },
}

impl ToManager {
    /// How many frame types there are.
    pub(super) const COUNT: u32 = 6;
}

impl ToNode {
    /// How many frame types there are.
    pub(super) const COUNT: u32 = 9;

    /// How many descriptors the frame carries.
    pub(super) const fn fds(&self) -> usize {
        match self {
            Self::Link { .. } => 1,
            _ => 0,
        }
    }
}
