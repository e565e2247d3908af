//! The inputs and outputs of the Manager.

use alloc::{sync::Arc, vec::Vec};

use crate::{
    Code, Datagram, Farewell, LinkId, NodeId, Violation, control::PolicyProblem,
    policy::AccessPolicy,
};

/// The credentials of the process at the other end of a connection, as the kernel reports them.
//= SM2-TRN-006
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Credentials {
    /// The user.
    pub uid: u32,
    /// The group.
    pub gid: u32,
    /// The process.
    pub pid: i32,
}

/// An input of the Manager. Only `LinkFailed` may be fed while outputs wait.
#[derive(Clone, Debug)]
pub enum Input<'a> {
    /// A connection was accepted.
    Connected {
        /// The driver's number for the connection: greater than all numbers before, and not zero.
        session: NodeId,
        /// The peer's credentials.
        credentials: Credentials,
    },
    /// The groups of a connection's process, beside that of its credentials. To be fed before its
    /// first datagram; without it, an access policy knows the session by the group of its
    /// credentials alone.
    Groups {
        /// The node's session.
        session: NodeId,
        /// The group ids.
        gids: &'a [u32],
    },
    /// A node sent a datagram.
    Datagram {
        /// The node's session.
        session: NodeId,
        /// The datagram and the facts about its descriptors.
        datagram: Datagram<'a>,
    },
    /// A node closed its end of the connection.
    Closed {
        /// The node's session.
        session: NodeId,
    },
    /// A node does not read its socket or does not take descriptors: the Manager gives it up.
    Stalled {
        /// The node's session.
        session: NodeId,
    },
    /// The driver could not make the socket pair of a link. Neither end has been told of the link.
    /// The Manager tries again at a deadline, with another link.
    LinkFailed {
        /// The link.
        link: LinkId,
    },
    /// A node's socket has taken all that was sent to it. The driver has to feed this input at
    /// least when [`Manager::awaits_room`](super::Manager::awaits_room) is true for the session.
    Drained {
        /// The node's session.
        session: NodeId,
    },
    /// The domain has another access policy; `None`: everything is allowed. The Manager applies the
    /// policy in parts: see [`Manager::is_applying_policy`](super::Manager::is_applying_policy).
    SetAccessPolicy(Option<Arc<AccessPolicy>>),
    /// The access policy cannot be read again: the answer to [`Output::ReadAccessPolicy`] beside
    /// `SetAccessPolicy`. The policy before stays in force.
    AccessPolicyUnusable {
        /// The kind of problem.
        problem: PolicyProblem,
        /// The problem in words. Nodes are sent the first
        /// [`RELOAD_TEXT_MAX`](crate::limits::RELOAD_TEXT_MAX) bytes.
        text: &'a str,
    },
    /// The deadline has come.
    Tick,
    /// The Manager has released its lock so that a standby can take over. It says goodbye to all
    /// standbys, which are the nodes whose names begin with
    /// [`STANDBY_PREFIX`](super::STANDBY_PREFIX).
    DismissStandbys,
    /// The Manager ends and says goodbye to all nodes. Their links stay.
    Shutdown,
}

/// A task for the driver.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Send a frame.
    Send {
        /// The receiver.
        session: NodeId,
        /// The datagram.
        frame: Vec<u8>,
    },
    /// Make a socket pair and send one end with each of the two frames. If the system has no
    /// descriptors for it, feed [`Input::LinkFailed`] and send neither frame.
    Link {
        /// The link.
        link: LinkId,
        /// The two receivers and their frames.
        ends: [(NodeId, Vec<u8>); 2],
    },
    /// Keep the descriptor of the datagram just handled until the session ends: it is the file of
    /// the node's counters.
    KeepCounters {
        /// The node's session.
        session: NodeId,
    },
    /// Send a frame with a duplicate of the descriptor that was kept for a session.
    SendCounters {
        /// The receiver.
        session: NodeId,
        /// The datagram.
        frame: Vec<u8>,
        /// The session whose counters are sent.
        of: NodeId,
    },
    /// Read the access policy of the domain, and feed [`Input::SetAccessPolicy`] or
    /// [`Input::AccessPolicyUnusable`]. One reading answers all requests before it.
    ReadAccessPolicy,
    /// Send the goodbye, if any, as far as the socket takes it, and close the connection. The
    /// machine has forgotten the session.
    HangUp {
        /// The session.
        session: NodeId,
        /// The GOODBYE frame.
        goodbye: Option<Vec<u8>>,
        /// The reason.
        cause: Cause,
    },
}

/// The reason why a session ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Cause {
    /// The node broke SPEC.
    Violation(Violation),
    /// The node closed its end of the connection.
    Gone,
    /// The node said goodbye.
    Goodbye(Code),
    /// The Manager gave the node up.
    Farewell(Farewell),
}

/// A mistake of the driver. The machine has not changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Misuse {
    /// The numbers of connections must grow.
    #[error("session numbers must grow: {0} was used before")]
    SessionNumber(NodeId),
}

impl Cause {
    /// The code of the GOODBYE; `None` if the node does not listen any more.
    pub(super) fn code(self) -> Option<Code> {
        match self {
            Self::Violation(violation) => Some(violation.code()),
            Self::Farewell(farewell) => Some(farewell.code()),
            Self::Gone | Self::Goodbye(_) => None,
        }
    }
}
