//! The phases of a session, and the requests that are legal in each (SPEC section 4.1).

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
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Request {
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
}

/// Every phase.
pub const PHASES: [Phase; 3] = [Phase::Greeting, Phase::Resuming, Phase::Ready];

/// Every request.
pub const REQUESTS: [Request; 13] = [
    Request::Hello,
    Request::Declare,
    Request::Withdraw,
    Request::Unlinked,
    Request::Query,
    Request::Goodbye,
    Request::Claim,
    Request::Claimed,
    Request::Watch,
    Request::Counters,
    Request::Inspect,
    Request::Schema,
    Request::Describe,
];

impl Request {
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
        }
    }
}

/// Checks whether a request is legal in a phase.
//= SM2-SES-001, SM2-RES-003
pub const fn legal(phase: Phase, request: Request) -> Result<(), Violation> {
    match (phase, request) {
        (_, Request::Goodbye) | (Phase::Greeting, Request::Hello) => Ok(()),
        (Phase::Greeting, _) => Err(violation!(ExpectedHello, "SM2-SES-001")),
        (Phase::Resuming | Phase::Ready, Request::Hello) => {
            Err(violation!(UnexpectedHello, "SM2-SES-001"))
        }
        (Phase::Ready, Request::Claim | Request::Claimed) => {
            Err(violation!(UnexpectedClaim, "SM2-RES-003"))
        }
        (
            Phase::Resuming | Phase::Ready,
            Request::Declare
            | Request::Withdraw
            | Request::Unlinked
            | Request::Query
            | Request::Claim
            | Request::Claimed
            | Request::Watch
            | Request::Counters
            | Request::Inspect
            | Request::Schema
            | Request::Describe,
        ) => Ok(()),
    }
}
