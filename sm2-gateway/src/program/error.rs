//! The errors of commands.

use std::{io, net::SocketAddr, path::PathBuf};

use sm2_node::{ConnectError, domain::QueryError};

use crate::{ConfigError, RunError, keys::KeyFileError, report::ReportError};

/// Why a command failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProgramError {
    /// The configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The key.
    #[error(transparent)]
    Key(#[from] KeyFileError),
    /// The gateway.
    #[error(transparent)]
    Run(#[from] RunError),
    /// A system call for the runtime, signals or a file.
    #[error("cannot {what}: {source}")]
    System {
        /// The attempted action.
        what: String,
        /// The error of the system.
        r#source: io::Error,
    },
    /// A peer on the command line is not in the configuration.
    #[error("{config} has no peer {peer}; its peers: {known}")]
    NoPeer {
        /// The configuration.
        config: PathBuf,
        /// The name or id on the command line.
        peer: String,
        /// The names of the peers in the configuration.
        known: String,
    },
    /// The connection to the domain.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// A query of the domain.
    #[error(transparent)]
    Query(#[from] QueryError),
    /// A status request.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// The address for metrics is in use, or does not belong to this machine.
    #[error("cannot serve metrics at {address}: {source}; choose another address with `--metrics`")]
    Metrics {
        /// The address.
        address: SocketAddr,
        /// The error of the system.
        r#source: io::Error,
    },
    /// The domain has no gateway.
    #[error("this domain has no gateway: start one with `sm2 gateway run FILE`")]
    NoGateway,
    /// A peer has the id of the gateway itself.
    #[error("{config}: a peer has the id of this gateway itself: remove that [[peer]]")]
    OwnId {
        /// The configuration.
        config: PathBuf,
    },
}

impl ProgramError {
    pub(super) fn system(what: impl Into<String>) -> impl FnOnce(io::Error) -> Self {
        let what = what.into();
        |source| Self::System { what, source }
    }
}
