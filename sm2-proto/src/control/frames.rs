//! The frames as types. The order of variants and fields is the wire format.

use alloc::{string::String, vec::Vec};

use serde::{Deserialize, Serialize};

use super::items::{Change, Item, Key};
use crate::{Code, Contract, InterfaceId, LinkId, LinkKey, Name, NodeId, Refusal, TypeId};

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
        /// Whether it comes back with interfaces and links from an earlier session.
        resuming: bool,
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
        after: Option<Key>,
    },
    /// The node hangs up.
    Goodbye {
        /// Why.
        code: Code,
    },
    /// The resuming node has an open link that an earlier Manager made.
    Claim {
        /// Of which interface.
        interface: InterfaceId,
        /// Which link.
        link: LinkId,
        /// What only its two ends know.
        key: LinkKey,
        /// The version spoken on it.
        version: u16,
        /// Whether nothing on it may be displaced.
        reliable: bool,
        /// Whether every message on it is inline or sealed.
        sealed: bool,
    },
    /// The resuming node has claimed all that it has.
    Claimed,
    /// The node waits for a change of the domain.
    Watch {
        /// The revision that it knows.
        after: u64,
    },
    /// The node's counters; their file comes along.
    Counters,
    /// The node asks for the counters of a node.
    Inspect {
        /// Which.
        node: NodeId,
    },
    /// The node registers the text of a type.
    Schema {
        /// Which type.
        data: TypeId,
        /// Its text (SPEC Annex A).
        text: String,
    },
    /// The node asks for the text of a type.
    Describe {
        /// Which type.
        data: TypeId,
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
        /// What only its two ends know.
        key: LinkKey,
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
        /// In ascending order of their keys.
        items: Vec<Item>,
        /// Where to go on, if more follow.
        next: Option<Key>,
    },
    /// The Manager hangs up.
    Goodbye {
        /// Why.
        code: Code,
    },
    /// The domain has changed.
    Changes {
        /// What the changes lead to.
        revision: u64,
        /// The changes; none if the Manager does not remember them all.
        changes: Option<Vec<Change>>,
        /// Whether there are more at once.
        more: bool,
    },
    /// The counters of a node; their file comes along.
    Inspected {
        /// Which node.
        node: NodeId,
    },
    /// A node has no counters, or is not there.
    NotInspected {
        /// Which node.
        node: NodeId,
    },
    /// The text of a type, if anybody registered it.
    Described {
        /// Which type.
        data: TypeId,
        /// Its text (SPEC Annex A).
        text: Option<String>,
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

impl ToManager {
    /// How many frame types there are.
    pub(super) const COUNT: u32 = 13;

    /// How many descriptors the frame carries.
    pub(super) const fn fds(&self) -> usize {
        match self {
            Self::Counters => 1,
            _ => 0,
        }
    }
}

impl ToNode {
    /// How many frame types there are.
    pub(super) const COUNT: u32 = 13;

    /// How many descriptors the frame carries.
    pub(super) const fn fds(&self) -> usize {
        match self {
            Self::Link { .. } | Self::Inspected { .. } => 1,
            _ => 0,
        }
    }
}
