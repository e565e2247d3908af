//! The errors of the commands.

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
    /// The runtime, signals, or a file.
    #[error("cannot {what}: {source}")]
    System {
        /// What was to be done.
        what: String,
        /// What the system said.
        source: io::Error,
    },
    /// A name of the command line is not in the configuration.
    #[error("{config} has no peer {peer}: it knows {known}")]
    NoPeer {
        /// Which file.
        config: PathBuf,
        /// What was asked for.
        peer: String,
        /// Those that are there.
        known: String,
    },
    /// The domain.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// The domain.
    #[error(transparent)]
    Query(#[from] QueryError),
    /// A gateway does not say how it is.
    #[error(transparent)]
    Report(#[from] ReportError),
    /// The address for metrics is taken, or not of this machine.
    #[error("cannot answer for metrics at {address}: {source}; `--metrics` says where")]
    Metrics {
        /// Which.
        address: SocketAddr,
        /// What the system said.
        source: io::Error,
    },
    /// No gateway is there.
    #[error("this domain has no gateway: start one with `sm2 gateway run FILE`")]
    NoGateway,
    /// What was to be added is not right.
    #[error("{0}")]
    Wrong(String),
}

impl ProgramError {
    pub(super) fn system(what: impl Into<String>) -> impl FnOnce(io::Error) -> Self {
        let what = what.into();
        |source| Self::System { what, source }
    }
}
