//! Errors of a running bridge.

use std::io;

use sm2_node::domain::QueryError;
use sm2_node::{ConnectError, WaitError};
use sm2_proto::NameError;

use crate::store::StoreError;

/// The reason why a bridge cannot start, or go on.
#[derive(Debug, thiserror::Error)]
pub enum BridgeError {
    /// The domain has no Manager that answers, or it refuses the bridge.
    #[error("cannot join the domain: {0}")]
    Connect(ConnectError),
    /// The name of the bridge is too long for the names of its nodes.
    #[error("the name of the bridge is too long: {0}")]
    Name(NameError),
    /// The network refuses the bridge, or one of its attempts.
    #[error("cannot {action}: {error}")]
    Network {
        /// The attempt.
        action: &'static str,
        /// The error, in the words of the network's library.
        error: String,
    },
    /// The folder of durable topics cannot be used.
    #[error("the spool of durable topics: {0}")]
    Spool(StoreError),
    /// The domain cannot be followed.
    #[error("cannot follow the domain: {0}")]
    Query(QueryError),
    /// The bridge cannot wait for events.
    #[error("cannot wait for events: {0}")]
    Wait(WaitError),
    /// The operating system refuses something that the bridge needs.
    #[error("the operating system refuses a resource: {0}")]
    System(io::Error),
}

impl From<io::Error> for BridgeError {
    fn from(error: io::Error) -> Self {
        Self::System(error)
    }
}

impl From<QueryError> for BridgeError {
    fn from(error: QueryError) -> Self {
        Self::Query(error)
    }
}
