//! How far a session has come, and what it may then ask (SPEC section 4.1).

use crate::{Violation, control::ToManager};

/// The state of a session; an ended one is not kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Phase {
    /// Connected; its HELLO has not been granted.
    Greeting,
    /// Welcomed.
    Ready,
}

/// What a frame asks for.
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
}

/// Every phase.
pub const PHASES: [Phase; 2] = [Phase::Greeting, Phase::Ready];

/// Every request.
pub const REQUESTS: [Request; 6] = [
    Request::Hello,
    Request::Declare,
    Request::Withdraw,
    Request::Unlinked,
    Request::Query,
    Request::Goodbye,
];

impl Request {
    pub(super) const fn of(frame: &ToManager) -> Self {
        match frame {
            ToManager::Hello { .. } => Self::Hello,
            ToManager::Declare { .. } => Self::Declare,
            ToManager::Withdraw { .. } => Self::Withdraw,
            ToManager::Unlinked { .. } => Self::Unlinked,
            ToManager::Query { .. } => Self::Query,
            ToManager::Goodbye { .. } => Self::Goodbye,
        }
    }
}

/// Whether a session may ask this now.
//= SM2-SES-001
pub const fn legal(phase: Phase, request: Request) -> Result<(), Violation> {
    match (phase, request) {
        (_, Request::Goodbye) | (Phase::Greeting, Request::Hello) => Ok(()),
        (Phase::Greeting, _) => Err(Violation::ExpectedHello),
        (Phase::Ready, Request::Hello) => Err(Violation::UnexpectedHello),
        (
            Phase::Ready,
            Request::Declare | Request::Withdraw | Request::Unlinked | Request::Query,
        ) => Ok(()),
    }
}
