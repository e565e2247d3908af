//! The errors of a gateway's nodes.

use std::io;

use sm2_node::{ConnectError, DeclareError};
use sm2_proto::NameError;

/// Why a gateway cannot join a domain or declare an interface there.
#[derive(Debug, thiserror::Error)]
pub enum LocalError {
    /// No Manager answers, or it refuses the node.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// The Manager refuses the interface.
    #[error(transparent)]
    Declare(#[from] DeclareError),
    /// The system has no more descriptors or threads.
    #[error("cannot start to follow the domain: {0}; `ulimit -n` and `ulimit -u` show the limits")]
    Io(io::Error),
    /// The name of the gateway or peer is too long for the name of a node.
    #[error(transparent)]
    Name(#[from] NameError),
}

impl From<io::Error> for LocalError {
    fn from(error: io::Error) -> Self {
        Self::Io(error)
    }
}

impl LocalError {
    /// True if no Manager has answered.
    pub(crate) const fn lacks_manager(&self) -> bool {
        matches!(
            self,
            Self::Connect(_)
                | Self::Declare(DeclareError::ManagerGone { .. } | DeclareError::TimedOut { .. })
        )
    }
}
