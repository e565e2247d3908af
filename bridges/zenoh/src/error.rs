//! Errors of a running bridge.

use sm2_bridge_core::StoreError;
use sm2_node::domain::QueryError;
use sm2_node::{ConnectError, WaitError};
use sm2_proto::NameError;

/// The reason why a bridge cannot start, or go on.
#[derive(Debug, thiserror::Error)]
pub enum BridgeError {
    /// The domain has no Manager that answers, or it refuses the bridge.
    #[error("cannot join the domain: {0}")]
    Connect(#[from] ConnectError),
    /// The name of the bridge is too long for the names of its nodes.
    #[error("the name of the bridge is too long: {0}")]
    Name(#[from] NameError),
    /// Zenoh refuses the configuration, or cannot open a session.
    #[error("cannot {action}: {error}")]
    Zenoh {
        /// The attempt.
        action: &'static str,
        /// The error, in the words of Zenoh.
        error: String,
    },
    /// The domain cannot be followed.
    #[error("cannot follow the domain: {0}")]
    Query(#[from] QueryError),
    /// The folder of durable topics cannot be used.
    #[error("the spool of durable topics: {0}")]
    Spool(#[from] StoreError),
    /// The bridge cannot wait for events.
    #[error("cannot wait for events: {0}")]
    Wait(#[source] WaitError),
    /// The operating system refuses something that the bridge needs.
    #[error("the operating system refuses a resource: {0}")]
    System(#[from] std::io::Error),
}

impl BridgeError {
    pub(crate) fn zenoh(action: &'static str) -> impl FnOnce(zenoh::Error) -> Self {
        move |error| Self::Zenoh {
            action,
            error: error.to_string(),
        }
    }
}
