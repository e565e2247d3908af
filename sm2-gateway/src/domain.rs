//! The domain that a gateway or a command connects to.

use std::{path::PathBuf, time::Duration};

use sm2_node::{ConnectError, Node};

/// Timeout of each exchange with the Manager.
const MANAGER_TIMEOUT: Duration = Duration::from_secs(2);

/// How to find the Manager of a domain.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum DomainLocation {
    /// `$SM2_SOCKET` or `$SM2_DOMAIN`, else the domain `default`.
    #[default]
    Environment,
    /// The name of the domain.
    Name(String),
    /// The path of the Manager's socket.
    Socket(PathBuf),
}

impl DomainLocation {
    /// Connects a node with this name to the domain.
    ///
    /// # Errors
    /// See [`ConnectError`].
    pub fn connect(&self, node_name: &str) -> Result<Node, ConnectError> {
        // No task of a gateway drives its nodes.
        let builder = Node::builder(node_name)
            .manager_timeout(MANAGER_TIMEOUT)
            .background(true);
        let builder = match self {
            Self::Environment => builder,
            Self::Name(name) => builder.domain(name),
            Self::Socket(path) => builder.socket(path),
        };
        builder.connect()
    }
}
