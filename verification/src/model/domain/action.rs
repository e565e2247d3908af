//! The actions of the model, and their text in a trace.

use std::fmt;

use sm2_proto::{InterfaceId, LinkId};

/// One event. Nodes are counted from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Action {
    /// The Manager reads a node's next frame, or the end of its connection.
    ManagerReads(u8),
    /// A node reads its next frame, or the end of its connection.
    NodeReads(u8),
    /// A node connects, for the first time or again.
    Connects(u8),
    /// A node sees that the other end of a link has closed.
    Notices(u8, InterfaceId, LinkId),
    /// Another Manager starts.
    ManagerBegins,
    /// The Manager does the next part of work that it has cut.
    ManagerWorks,
    /// No action is possible before the Manager's next deadline, so time advances to it.
    TimePasses,
    /// A program declares its first interface that is not declared.
    Declares(u8),
    /// A program withdraws an interface.
    Withdraws(u8, InterfaceId),
    /// A program ends a link.
    Closes(u8, InterfaceId, LinkId),
    /// A process dies.
    NodeDies(u8),
    /// The Manager dies. Frames that it has sent still arrive.
    ManagerDies,
    /// The Manager reads a node's next frame and dies after sending this many frames of its answer.
    ManagerDiesAnswering(u8, u8),
    /// The Manager shuts down in order, so that another one can take its place.
    ManagerShutsDown,
    /// A node does not read in time, and the Manager closes its connection.
    Stalls(u8),
    /// The domain gets the other access policy, and the Manager, if there is one, reads it.
    PolicyChanges,
}

impl Action {
    /// True if the action happens sooner or later without a choice; otherwise it costs a part of
    /// the budget.
    #[must_use]
    pub const fn goes_on(&self) -> bool {
        matches!(
            self,
            Self::ManagerReads(_)
                | Self::NodeReads(_)
                | Self::Connects(_)
                | Self::Notices(..)
                | Self::ManagerBegins
                | Self::ManagerWorks
                | Self::TimePasses
        )
    }
}

impl fmt::Display for Action {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::ManagerReads(at) => write!(f, "the Manager reads from node {at}"),
            Self::NodeReads(at) => write!(f, "node {at} reads"),
            Self::Connects(at) => write!(f, "node {at} connects"),
            Self::Notices(at, interface, link) => {
                write!(f, "node {at} sees the end of {link} at {interface}")
            }
            Self::ManagerBegins => write!(f, "another Manager begins"),
            Self::ManagerWorks => write!(f, "the Manager goes on with its work"),
            Self::TimePasses => write!(f, "time passes until the Manager's deadline"),
            Self::Declares(at) => write!(f, "node {at} declares"),
            Self::Withdraws(at, interface) => write!(f, "node {at} withdraws {interface}"),
            Self::Closes(at, interface, link) => {
                write!(f, "node {at} ends {link} at {interface}")
            }
            Self::NodeDies(at) => write!(f, "the process of node {at} dies"),
            Self::ManagerDies => write!(f, "the Manager dies"),
            Self::ManagerDiesAnswering(at, sent) => write!(
                f,
                "the Manager reads from node {at} and dies after {sent} frames of its answer"
            ),
            Self::ManagerShutsDown => write!(f, "the Manager shuts down"),
            Self::Stalls(at) => write!(f, "the Manager gives up node {at}, which does not read"),
            Self::PolicyChanges => write!(f, "the access policy changes"),
        }
    }
}
