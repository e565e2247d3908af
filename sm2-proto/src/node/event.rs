//! What goes into a node's session and what comes out of it.

use alloc::{string::String, vec::Vec};

use crate::{
    Code, Datagram, InterfaceId, LinkId, Name, NodeId, QosError, Refusal, TypeId, Violation,
    control::{Change, Item, Key, Peer},
};

/// What happens to a node. `Datagram` requires that the outputs of the input before are drained:
/// its descriptor belongs to the next output. All other inputs may come while outputs wait.
#[derive(Clone, Debug)]
pub enum Input<'a> {
    /// The Manager sent a datagram.
    Datagram(Datagram<'a>),
    /// The Manager's end of the connection is gone.
    Eof,
    /// After [`Output::HelloRefused`]: greet again, under this name.
    Greet(Name),
    /// Drop an interface that was declared, and all its links with it; without a session
    /// also one whose declaration waits.
    Withdraw {
        /// Which.
        interface: InterfaceId,
    },
    /// The machine of a link has ended. Harmless if the Manager said so first, and
    /// without a session: then the link is forgotten.
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
        after: Option<Key>,
    },
    /// Ask for the changes since a revision.
    Watch {
        /// The revision that is known.
        after: u64,
    },
    /// Hand over the file of this node's counters, once per session.
    Counters,
    /// Ask for the counters of a node.
    Inspect {
        /// Which.
        node: NodeId,
    },
    /// Register the text of a type.
    Schema {
        /// Which type.
        data: TypeId,
        /// Its text (SPEC Annex A); its hash is the type's.
        text: String,
    },
    /// Ask for the text of a type.
    Describe {
        /// Which type.
        data: TypeId,
    },
    /// After [`Output::Ended`] or [`Output::HelloRefused`]: there is a new connection with
    /// a Manager. The node greets again, and brings along what it has (SM2-RES-002).
    Reconnected,
    /// End the session, if there is one, and the machine.
    Close(Code),
}

/// What the driver has to do, or to know.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Send these bytes as one datagram.
    Transmit(Vec<u8>),
    /// Send these bytes as one datagram, and with it the file of this node's counters.
    TransmitCounters(Vec<u8>),
    /// The Manager has granted the greeting; after the first time [`Output::Resumed`]
    /// follows when it knows all that we have.
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
    /// The interface was not granted. One that was live in an earlier session keeps its
    /// links and is declared again with the next session (SM2-RES-009); of any other
    /// the number is spent.
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
    /// The Manager ended a link, or did with an earlier session: end its machine with this code.
    Unlink {
        /// Of which interface.
        interface: InterfaceId,
        /// Which link.
        link: LinkId,
        /// Why.
        code: Code,
    },
    /// The interface is gone at the Manager too, if there is one.
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
    /// The domain has changed: the answer to [`Input::Watch`].
    Changes {
        /// What the changes lead to.
        revision: u64,
        /// The changes; none if the Manager does not remember them all.
        changes: Option<Vec<Change>>,
        /// Whether there are more at once.
        more: bool,
    },
    /// The counters of a node: the file is the descriptor of the datagram just handled.
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
    /// All that the node brought along from earlier sessions is declared and claimed.
    Resumed,
    /// The session is over: close the connection. Always its last output. Links go on;
    /// the machine waits for [`Input::Reconnected`], unless we closed it.
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

/// The reason why an input was not taken. `Ended` names the end of the latest session; while
/// [`Node::is_away`](super::Node::is_away), another session may follow.
pub type Error = crate::Error<End, Misuse>;

/// What a caller did wrong. Nothing was sent and nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Misuse {
    /// The session is not ready.
    #[error("the Manager has not welcomed this node yet")]
    NotReady,
    /// A greeting is legal only after a refusal.
    #[error("the Manager has not refused a greeting")]
    NotRefused,
    /// The session is not over.
    #[error("the session with the Manager is not over: reconnect when it is")]
    Connected,
    /// A node that was welcomed once keeps its name (SM2-RES-001).
    #[error("this node resumes its session: it greets under the name that it had")]
    OtherName,
    /// The interface is not live.
    #[error("no live interface has that number")]
    NotLive,
    /// All 2^64 - 1 numbers of interfaces are used (SM2-IFC-001).
    #[error("no number is left for another interface: end this node and begin a new one")]
    NumbersSpent,
    /// One WATCH at a time (SM2-WCH-001).
    #[error("the changes that were asked for have not come yet: wait for them")]
    WatchTwice,
    /// COUNTERS goes out once per session (SM2-CNT-001).
    #[error("the Manager has the counters of this session already")]
    CountersTwice,
    /// The text is not a schema with the type's hash (SM2-SCH-001).
    #[error("the text is no schema of that type: its hash is another, or it is malformed")]
    Schema,
    /// The contract is out of range.
    #[error("{field} is {value}, which is out of range (SM2-FRM-003)")]
    Qos {
        /// Which value.
        field: &'static str,
        /// What it is.
        value: u16,
    },
}

impl From<QosError> for Misuse {
    fn from(QosError { field, value, .. }: QosError) -> Self {
        Self::Qos { field, value }
    }
}
