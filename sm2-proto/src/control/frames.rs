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
        /// The oldest version that the node speaks.
        min_version: u16,
        /// The newest version that the node speaks.
        max_version: u16,
        /// The name that the node asks for.
        name: Name,
        /// Whether the node brings along interfaces and links from an earlier session.
        resuming: bool,
    },
    /// The node declares an interface.
    Declare {
        /// The node's number for the interface.
        interface: InterfaceId,
        /// The contract.
        contract: Contract,
    },
    /// The node withdraws an interface.
    Withdraw {
        /// The interface.
        interface: InterfaceId,
    },
    /// The node's end of a link is closed.
    Unlinked {
        /// The interface of the link.
        interface: InterfaceId,
        /// The link.
        link: LinkId,
        /// The reason.
        code: Code,
    },
    /// The node asks for a page of the domain's state.
    Query {
        /// The last item that the node knows.
        after: Option<Key>,
    },
    /// The node ends the session.
    Goodbye {
        /// The reason.
        code: Code,
    },
    /// A resuming node claims an open link that an earlier Manager made.
    Claim {
        /// The interface of the link.
        interface: InterfaceId,
        /// The link.
        link: LinkId,
        /// The key that the earlier Manager sent with LINK.
        key: LinkKey,
        /// The protocol version of the link.
        version: u16,
        /// Whether no message may be displaced.
        reliable: bool,
        /// Whether every message is inline or sealed.
        sealed: bool,
    },
    /// A resuming node has claimed all its links.
    Claimed,
    /// The node waits for a change of the domain.
    Watch {
        /// The revision that the node knows.
        after: u64,
    },
    /// The node's counters. The descriptor of their file comes along.
    Counters,
    /// The node asks for the counters of a node.
    Inspect {
        /// The node.
        node: NodeId,
    },
    /// The node registers the text of a type.
    Schema(SchemaText),
    /// The node asks for the text of a type.
    Describe {
        /// The type.
        data: TypeId,
    },
    /// The node states how many ends of links it can have at a time (SM2-LNK-007).
    MaxLinks {
        /// The number. The newest one counts.
        max_links: u32,
    },
    /// The node asks the Manager to read the access policy of its domain again.
    Reload,
    /// The node gives its program nothing more of an interface that the access policy denies.
    Suspended {
        /// The interface.
        interface: InterfaceId,
    },
}

/// A frame from the Manager to a node.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ToNode {
    /// The Manager grants the greeting.
    Welcome {
        /// The version of this session.
        version: u16,
        /// This Manager's incarnation.
        epoch: u64,
        /// The number of the node.
        node: NodeId,
    },
    /// The Manager refuses the greeting. The node may greet again.
    HelloRefused {
        /// The reason.
        reason: Refusal,
    },
    /// The interface is live.
    Declared {
        /// The interface.
        interface: InterfaceId,
        /// The number of LINKs for the interface that follow at once.
        matches: u32,
    },
    /// The Manager refuses the interface.
    DeclareRefused {
        /// The interface.
        interface: InterfaceId,
        /// The reason.
        reason: Refusal,
    },
    /// A link for an interface. One end of its socket pair comes along.
    Link {
        /// The node's interface.
        interface: InterfaceId,
        /// The link.
        link: LinkId,
        /// The key that claims the link from the next Manager.
        key: LinkKey,
        /// The protocol version of the link.
        version: u16,
        /// Whether no message may be displaced.
        reliable: bool,
        /// Whether every message is inline or sealed.
        sealed: bool,
        /// The interface on the other side.
        peer: LinkPeer,
    },
    /// The Manager ends a link.
    Unlink {
        /// The interface of the link.
        interface: InterfaceId,
        /// The link.
        link: LinkId,
        /// The reason.
        code: Code,
    },
    /// The interface is withdrawn.
    Withdrawn {
        /// The interface.
        interface: InterfaceId,
    },
    /// A page of the domain's state.
    Page(Page),
    /// The Manager ends the session.
    Goodbye {
        /// The reason.
        code: Code,
    },
    /// The domain has changed.
    Changes(Changes),
    /// The counters of a node. The descriptor of their file comes along.
    Inspected {
        /// The node.
        node: NodeId,
    },
    /// A node has no counters, or does not exist.
    NotInspected {
        /// The node.
        node: NodeId,
    },
    /// The text of a type, if a node registered one.
    Described {
        /// The type.
        data: TypeId,
        /// The text of the type (SPEC Annex A).
        text: Option<String>,
    },
    /// The Manager had no free descriptor for the file that came with COUNTERS, and may have one
    /// now: the node sends COUNTERS again.
    CountersLost,
    /// The access policy is read again, or it is not.
    Reloaded {
        /// The outcome.
        outcome: ReloadOutcome,
    },
}

/// The outcome of a RELOAD.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum ReloadOutcome {
    /// The policy that was read after the RELOAD, or a later one, is applied.
    Applied,
    /// The domain had no policy before, and has none now.
    NoPolicy,
    /// Neither the user of the Manager's process nor root asked.
    NotPermitted,
    /// The policy cannot be used. The one before stays in force.
    Unusable {
        /// The kind of problem.
        problem: PolicyProblem,
        /// The problem in words, for people.
        text: String,
    },
}

/// Why an access policy cannot be used (SM2-ACC-012).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum PolicyProblem {
    /// The file cannot be read.
    Unreadable,
    /// Another user owns the file or may write it.
    NotTrusted,
    /// The file is not a policy.
    Invalid,
}

/// The text of a type.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct SchemaText {
    /// The type.
    pub data: TypeId,
    /// The text of the type (SPEC Annex A), which has the type's hash.
    pub text: String,
}

/// A page of the domain's state.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Page {
    /// The revision of the page.
    pub revision: u64,
    /// The items, in ascending order of their keys.
    pub items: Vec<Item>,
    /// The key after which the next page starts, if more items follow.
    pub next: Option<Key>,
}

/// Changes of the domain since a revision.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Changes {
    /// The revision after these changes.
    pub revision: u64,
    /// The changes; `None` if the Manager has forgotten some of them.
    pub changes: Option<Vec<Change>>,
    /// Whether more changes are there already.
    pub more: bool,
}

/// The interface on the other side of a link.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct LinkPeer {
    /// The node.
    pub node: NodeId,
    /// The name of the node.
    pub name: Name,
    /// The node's number for the interface.
    pub interface: InterfaceId,
    /// The contract.
    pub contract: Contract,
}

impl ToManager {
    /// The number of frame types.
    pub(super) const COUNT: u32 = 16;

    /// The number of descriptors that the frame carries.
    pub(crate) const fn fds(&self) -> usize {
        match self {
            Self::Counters => 1,
            _ => 0,
        }
    }
}

impl ToNode {
    /// The number of frame types.
    pub(super) const COUNT: u32 = 15;

    /// The number of descriptors that the frame carries.
    pub(crate) const fn fds(&self) -> usize {
        match self {
            Self::Link { .. } | Self::Inspected { .. } => 1,
            _ => 0,
        }
    }
}
