//! What goes into the Manager and what comes out of it.

use alloc::vec::Vec;

use crate::{Code, Datagram, Farewell, LinkId, NodeId, Violation};

/// Who is at the other end of a connection, as the kernel says.
//= SM2-TRN-007
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Credentials {
    /// User.
    pub uid: u32,
    /// Group.
    pub gid: u32,
    /// Process.
    pub pid: i32,
}

/// What happens to a Manager. Only `LinkFailed` may come while outputs wait.
#[derive(Clone, Debug)]
pub enum Input<'a> {
    /// A connection was accepted.
    Connected {
        /// The driver's number for it: greater than all before, not zero.
        session: NodeId,
        /// Whose it is.
        credentials: Credentials,
    },
    /// A node sent a datagram.
    Datagram {
        /// Which node.
        session: NodeId,
        /// What it sent.
        datagram: Datagram<'a>,
    },
    /// A node's end of the connection is gone.
    Closed {
        /// Which node.
        session: NodeId,
    },
    /// A node does not read, or does not take descriptors: give it up.
    Stalled {
        /// Which node.
        session: NodeId,
    },
    /// There was no socket pair for a link: its two ends know nothing of it.
    LinkFailed {
        /// Which link.
        link: LinkId,
    },
    /// A node's socket has taken all that was sent to it. To be fed when that is so, at least if
    /// [`Manager::awaits_room`](super::Manager::awaits_room) says so.
    Drained {
        /// Which node.
        session: NodeId,
    },
    /// The deadline has come.
    Tick,
    /// The Manager has given up its lock, for whoever wants to take over: say goodbye to
    /// the standbys, which are nodes whose names begin with
    /// [`STANDBY_PREFIX`](super::STANDBY_PREFIX).
    DismissStandbys,
    /// The Manager ends: say goodbye to everybody. Their links live on.
    Shutdown,
}

/// What the driver has to do.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Send a frame.
    Send {
        /// To whom.
        session: NodeId,
        /// The datagram.
        frame: Vec<u8>,
    },
    /// Make a socket pair and send one end with each of the two frames. If
    /// there is none to be had, feed [`Input::LinkFailed`] and send neither.
    Link {
        /// Which link.
        link: LinkId,
        /// To whom, and what.
        ends: [(NodeId, Vec<u8>); 2],
    },
    /// Keep the descriptor of the datagram just handled as long as the session lives: the
    /// file of its counters.
    KeepCounters {
        /// Whose.
        session: NodeId,
    },
    /// Send a frame with a duplicate of the descriptor that was kept for a session.
    SendCounters {
        /// To whom.
        session: NodeId,
        /// The datagram.
        frame: Vec<u8>,
        /// Whose counters.
        of: NodeId,
    },
    /// Send the goodbye, if any, as far as the socket takes it, and close the
    /// connection. The machine does not know the session any more.
    HangUp {
        /// Whose.
        session: NodeId,
        /// The datagram to send.
        goodbye: Option<Vec<u8>>,
        /// Why.
        cause: Cause,
    },
}

/// Why a session is over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Cause {
    /// The node broke SPEC.
    Violation(Violation),
    /// Its end of the connection is gone.
    Gone,
    /// It said goodbye.
    Goodbye(Code),
    /// The Manager gave it up.
    Farewell(Farewell),
}

/// What a driver did wrong. Nothing has changed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Misuse {
    /// Numbers of connections must grow.
    #[error("session numbers must grow: {0} was used before")]
    SessionNumber(NodeId),
}

impl Cause {
    /// The code to say goodbye with; none if nobody is there to hear it.
    pub(super) fn code(self) -> Option<Code> {
        match self {
            Self::Violation(violation) => Some(violation.code()),
            Self::Farewell(farewell) => Some(farewell.code()),
            Self::Gone | Self::Goodbye(_) => None,
        }
    }
}
