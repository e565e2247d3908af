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
    /// The folder of the spool cannot be used.
    #[error("the spool: {0}")]
    Spool(#[from] StoreError),
    /// The domain cannot be followed.
    #[error("cannot follow the domain: {0}")]
    Query(#[from] QueryError),
    /// The bridge cannot wait for events.
    #[error("cannot wait for events: {0}")]
    Wait(#[source] WaitError),
    /// The operating system refuses something that the bridge needs.
    #[error("the operating system refuses a resource: {0}")]
    System(#[from] std::io::Error),
}
