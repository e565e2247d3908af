//! The inputs and outputs of a node's machine.

use alloc::{string::String, vec::Vec};

use crate::{
    Code, Datagram, InterfaceId, LinkId, LinkQos, Name, NodeId, QosError, Refusal, TypeId,
    Violation,
    control::{Changes, Key, LinkPeer, Page, ReloadOutcome, SchemaText},
};

/// An input of a node. `Datagram` requires that the outputs of the input before are drained,
/// because its descriptor belongs to the next output. All other inputs may be fed while outputs
/// wait.
#[derive(Clone, Debug)]
pub enum Input<'a> {
    /// The Manager sent a datagram.
    Datagram(Datagram<'a>),
    /// The Manager closed its end of the connection.
    Eof,
    /// Greet again under this name, after [`Output::HelloRefused`].
    Greet(Name),
    /// Withdraw an interface that was declared, and with it all its links. Without a session, this
    /// also takes back a declaration that has not been sent.
    Withdraw {
        /// The interface.
        interface: InterfaceId,
    },
    /// The machine of a link has ended. This input has no effect if the Manager ended the link
    /// first. Without a session the link is only forgotten.
    Unlinked {
        /// The interface of the link.
        interface: InterfaceId,
        /// The link.
        link: LinkId,
        /// The reason.
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
    /// Hand the file of this node's counters to the Manager, once per session.
    Counters,
    /// Ask for the counters of a node.
    Inspect {
        /// The node.
        node: NodeId,
    },
    /// State how many ends of links this node can have at a time. Legal in every state but *ended*;
    /// the machine tells each Manager (SM2-LNK-007).
    MaxLinks(u32),
    /// Register the text of a type.
    Schema(SchemaText),
    /// Ask for the text of a type.
    Describe {
        /// The type.
        data: TypeId,
    },
    /// Ask the Manager to read the access policy of its domain again, and to apply it.
    Reload,
    /// There is a new connection with a Manager, after [`Output::Ended`] or
    /// [`Output::HelloRefused`]. The node greets again and brings its interfaces and links along
    /// (SM2-RES-002).
    Reconnected,
    /// End the session, if there is one, and the machine.
    Close(Code),
}

/// A task for the driver, or an event for the program.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Send these bytes as one datagram.
    Transmit(Vec<u8>),
    /// Send these bytes as one datagram, with the file of this node's counters.
    TransmitCounters(Vec<u8>),
    /// The Manager has granted the greeting. From the second time on, [`Output::Resumed`] follows
    /// once the Manager knows all interfaces and links of this node.
    Welcomed {
        /// The number of this node.
        node: NodeId,
        /// The Manager's incarnation.
        epoch: u64,
        /// Whether the node resumes: [`Output::Resumed`] follows.
        resuming: bool,
    },
    /// The Manager has refused the greeting: greet again or close.
    HelloRefused(Refusal),
    /// The interface is live. Also if another access policy allows an interface again that the one
    /// before denied.
    Declared {
        /// The interface.
        interface: InterfaceId,
        /// The number of interfaces that it matched.
        matches: u32,
    },
    /// The interface was refused. An interface that was live before stays: if the access policy denies
    /// it, [`Output::Unlink`] ends its links, and [`Output::Declared`] follows once another policy
    /// allows it (SM2-ACC-013). With any other reason it keeps its links and is declared again in the
    /// next session (SM2-RES-010). Of any other interface, the number is spent.
    DeclareRefused {
        /// The interface.
        interface: InterfaceId,
        /// The reason.
        reason: Refusal,
    },
    /// A link was made. Its socket is the descriptor of the datagram just handled.
    Linked {
        /// The interface of the link.
        interface: InterfaceId,
        /// The link.
        link: LinkId,
        /// The protocol version of the link.
        version: u16,
        /// The QoS of the link.
        qos: LinkQos,
        /// The interface on the other side.
        peer: LinkPeer,
    },
    /// A link was made, but this process had no free descriptor for its socket. The machine has ended
    /// the link (`resources`), and the Manager will make another one.
    LinkLost {
        /// The interface of the link.
        interface: InterfaceId,
        /// The link.
        link: LinkId,
        /// The interface on the other side.
        peer: LinkPeer,
    },
    /// The Manager ended this link, now or with an earlier session: end its machine with this code.
    /// With `denied`, the link may have ended before, and its messages that were not taken are
    /// discarded (SM2-ACC-014).
    Unlink {
        /// The interface of the link.
        interface: InterfaceId,
        /// The link.
        link: LinkId,
        /// The reason.
        code: Code,
    },
    /// The interface is withdrawn; the Manager, if there is one, has confirmed it.
    Withdrawn {
        /// The interface.
        interface: InterfaceId,
    },
    /// A page of the domain's state.
    Page(Page),
    /// The domain has changed: the answer to [`Input::Watch`].
    Changes(Changes),
    /// The counters of a node. Their file is the descriptor of the datagram just handled.
    Inspected {
        /// The node.
        node: NodeId,
    },
    /// A node has no counters or does not exist, or this process had no free descriptor for their
    /// file.
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
    /// The answer to [`Input::Reload`].
    Reloaded(ReloadOutcome),
    /// The Manager knows all interfaces and links that this node brought along.
    Resumed,
    /// The session is over: close the connection. This is always the last output of a session.
    /// Links stay, and the machine waits for [`Input::Reconnected`], unless this node closed the
    /// session.
    Ended(End),
}

/// The reason why a session ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum End {
    /// This node closed the session.
    #[error("closed by this node ({0})")]
    Local(Code),
    /// The Manager said goodbye.
    #[error("the Manager hung up: {0}")]
    Peer(Code),
    /// The Manager closed the connection without a goodbye.
    #[error("the Manager is gone")]
    Eof,
    /// The Manager broke SPEC.
    #[error("the Manager broke the protocol: {0}")]
    Violation(Violation),
}

/// The reason why an input was not taken. `Ended` names the end of the latest session; while
/// [`Node::is_away`](super::Node::is_away), another session may follow.
pub type Error = crate::Error<End, Misuse>;

/// A mistake of the caller. Nothing was sent and nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Misuse {
    /// The Manager has not welcomed the node yet.
    #[error("the Manager has not welcomed this node yet")]
    NotReady,
    /// A second greeting is legal only after a refusal.
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
    /// One RELOAD at a time (SM2-ACC-016).
    #[error("the access policy is being read again already: wait for the answer")]
    ReloadTwice,
    /// COUNTERS goes out once per session (SM2-CNT-001).
    #[error("the Manager has the counters of this session already")]
    CountersTwice,
    /// The text is not a schema with the type's hash (SM2-SCH-001).
    #[error("the text is not a schema of that type: its hash is another, or it is malformed")]
    Schema,
    /// A QoS value of the contract is out of range.
    #[error("{field} is {value}, which is out of range (SM2-FRM-003)")]
    Qos {
        /// The name of the value.
        field: &'static str,
        /// The value.
        value: u16,
    },
}

impl From<QosError> for Misuse {
    fn from(QosError { field, value, .. }: QosError) -> Self {
        Self::Qos { field, value }
    }
}
