//! What goes into a node's session and what comes out of it.

use alloc::vec::Vec;

use crate::{
    Code, Datagram, InterfaceId, LinkId, Name, NodeId, QosError, Refusal, Violation,
    control::{Cursor, Item, Peer},
};

/// What happens to a node.
#[derive(Clone, Debug)]
pub enum Input<'a> {
    /// The Manager sent a datagram.
    Datagram(Datagram<'a>),
    /// The Manager's end of the connection is gone.
    Eof,
    /// After [`Output::HelloRefused`]: greet again, under this name.
    Greet(Name),
    /// Drop a live interface, and all its links with it.
    Withdraw {
        /// Which.
        interface: InterfaceId,
    },
    /// The machine of a link has ended. Harmless if the Manager said so first.
    Unlinked {
        /// Of which interface.
        interface: InterfaceId,
        /// Which link.
        link: LinkId,
        /// Why.
        code: Code,
    },
    /// Ask for a page of the domain's state.
    Query {
        /// The last item that is known.
        after: Option<Cursor>,
    },
    /// End the session.
    Close(Code),
}

/// What the driver has to do, or to know.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Send these bytes as one datagram.
    Transmit(Vec<u8>),
    /// The session is ready.
    Welcomed {
        /// Our number.
        node: NodeId,
        /// The Manager's incarnation.
        epoch: u64,
    },
    /// The Manager did not grant the greeting: greet again or close.
    HelloRefused(Refusal),
    /// The interface is live.
    Declared {
        /// Which.
        interface: InterfaceId,
        /// How many interfaces it matched.
        matches: u32,
    },
    /// The interface was not granted; its number is spent.
    DeclareRefused {
        /// Which.
        interface: InterfaceId,
        /// Why.
        reason: Refusal,
    },
    /// A link: its socket is the descriptor of the datagram just handled.
    Linked {
        /// Of which interface.
        interface: InterfaceId,
        /// Which link.
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
    /// The Manager ended a link: end its machine with this code.
    Unlink {
        /// Of which interface.
        interface: InterfaceId,
        /// Which link.
        link: LinkId,
        /// Why.
        code: Code,
    },
    /// The interface is gone at the Manager too.
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
    /// The session is over: close the connection. Always the last output.
    Ended(End),
}

/// Why a session is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum End {
    /// We closed it.
    #[error("closed by this node ({0})")]
    Local(Code),
    /// The Manager said goodbye.
    #[error("the Manager hung up: {0}")]
    Peer(Code),
    /// The Manager's end is gone without a word.
    #[error("the Manager is gone")]
    Eof,
    /// The Manager broke SPEC.
    #[error("the Manager broke the protocol: {0}")]
    Violation(Violation),
}

/// Why an input was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Error {
    /// The session is over.
    #[error(transparent)]
    Ended(#[from] End),
    /// The caller did what this state does not allow.
    #[error(transparent)]
    Misuse(#[from] Misuse),
}

/// What a caller did wrong. Nothing was sent and nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Misuse {
    /// The session is not ready.
    #[error("the Manager has not welcomed this node yet")]
    NotReady,
    /// A greeting is legal only after a refusal.
    #[error("the Manager has not refused a greeting")]
    NotRefused,
    /// The interface is not live.
    #[error("no live interface has that number")]
    NotLive,
    /// The contract is out of range.
    #[error("{field} is {value}, which is out of range (SM2-FRM-003)")]
    Qos {
        /// Which value.
        field: &'static str,
        /// What it is.
        value: u16,
    },
}

impl From<QosError> for Error {
    fn from(QosError { field, value, .. }: QosError) -> Self {
        Misuse::Qos { field, value }.into()
    }
}
