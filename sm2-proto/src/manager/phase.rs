//! The phases of a session, and the frames that are legal in each (SPEC section 4.1).

use crate::{Violation, control::ToManager};

/// The state of a session; a session that has ended is not kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Phase {
    /// Connected; its HELLO has not been granted.
    Greeting,
    /// Welcomed; the node claims the links that it brought along (SM2-RES-002).
    Resuming,
    /// Welcomed; the Manager knows all links of the node.
    Ready,
}

/// The kind of a frame from a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ToManagerKind {
    /// HELLO
    Hello,
    /// DECLARE
    Declare,
    /// WITHDRAW
    Withdraw,
    /// UNLINKED
    Unlinked,
    /// QUERY
    Query,
    /// GOODBYE
    Goodbye,
    /// CLAIM
    Claim,
    /// CLAIMED
    Claimed,
    /// WATCH
    Watch,
    /// COUNTERS
    Counters,
    /// INSPECT
    Inspect,
    /// SCHEMA
    Schema,
    /// DESCRIBE
    Describe,
    /// MAX_LINKS
    MaxLinks,
    /// RELOAD
    Reload,
    /// SUSPENDED
    Suspended,
}

/// Every phase.
pub const PHASES: [Phase; 3] = [Phase::Greeting, Phase::Resuming, Phase::Ready];

/// Every kind of frame from a node.
pub const TO_MANAGER_KINDS: [ToManagerKind; 16] = [
    ToManagerKind::Hello,
    ToManagerKind::Declare,
    ToManagerKind::Withdraw,
    ToManagerKind::Unlinked,
    ToManagerKind::Query,
    ToManagerKind::Goodbye,
    ToManagerKind::Claim,
    ToManagerKind::Claimed,
    ToManagerKind::Watch,
    ToManagerKind::Counters,
    ToManagerKind::Inspect,
    ToManagerKind::Schema,
    ToManagerKind::Describe,
    ToManagerKind::MaxLinks,
    ToManagerKind::Reload,
    ToManagerKind::Suspended,
];

impl ToManagerKind {
    pub(crate) const fn of(frame: &ToManager) -> Self {
        match frame {
            ToManager::Hello { .. } => Self::Hello,
            ToManager::Declare { .. } => Self::Declare,
            ToManager::Withdraw { .. } => Self::Withdraw,
            ToManager::Unlinked { .. } => Self::Unlinked,
            ToManager::Query { .. } => Self::Query,
            ToManager::Goodbye { .. } => Self::Goodbye,
            ToManager::Claim { .. } => Self::Claim,
            ToManager::Claimed => Self::Claimed,
            ToManager::Watch { .. } => Self::Watch,
            ToManager::Counters => Self::Counters,
            ToManager::Inspect { .. } => Self::Inspect,
            ToManager::Schema(_) => Self::Schema,
            ToManager::Describe { .. } => Self::Describe,
            ToManager::MaxLinks { .. } => Self::MaxLinks,
            ToManager::Reload => Self::Reload,
            ToManager::Suspended { .. } => Self::Suspended,
        }
    }
}

/// Checks whether a frame of this kind is legal in a phase.
//= SM2-SES-001, SM2-RES-003
pub const fn legal(phase: Phase, kind: ToManagerKind) -> Result<(), Violation> {
    match (phase, kind) {
        (_, ToManagerKind::Goodbye) | (Phase::Greeting, ToManagerKind::Hello) => Ok(()),
        (Phase::Greeting, _) => Err(violation!(ExpectedHello, "SM2-SES-001")),
        (Phase::Resuming | Phase::Ready, ToManagerKind::Hello) => {
            Err(violation!(UnexpectedHello, "SM2-SES-001"))
        }
        (Phase::Ready, ToManagerKind::Claim | ToManagerKind::Claimed) => {
            Err(violation!(UnexpectedClaim, "SM2-RES-003"))
        }
        (
            Phase::Resuming | Phase::Ready,
            ToManagerKind::Declare
            | ToManagerKind::Withdraw
            | ToManagerKind::Unlinked
            | ToManagerKind::Query
            | ToManagerKind::Claim
            | ToManagerKind::Claimed
            | ToManagerKind::Watch
            | ToManagerKind::Counters
            | ToManagerKind::Inspect
            | ToManagerKind::Schema
            | ToManagerKind::Describe
            | ToManagerKind::MaxLinks
            | ToManagerKind::Reload
            | ToManagerKind::Suspended,
        ) => Ok(()),
    }
}
