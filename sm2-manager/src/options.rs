//! How a Manager serves, and why it does not.

use std::{io, path::PathBuf};

use sm2_io::{BindOptions, DomainSocketError};

use crate::Policy;

/// How a Manager serves its domain.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    /// Quotas, and when links are sealed.
    pub policy: Policy,
    /// How many bytes are kept for a node that does not read; 32 more count for each frame.
    pub queue_bytes: usize,
    /// The socket's permission bits: who may connect needs to write. They do not count for
    /// a socket that was handed over.
    pub socket_mode: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            policy: Policy::default(),
            queue_bytes: 1 << 20,
            socket_mode: 0o600,
        }
    }
}

impl Options {
    pub(crate) fn bind_options(&self) -> BindOptions {
        BindOptions {
            mode: self.socket_mode,
            ..BindOptions::default()
        }
    }
}

/// Why a Manager did not start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StartError {
    /// The domain's socket cannot be claimed.
    #[error(transparent)]
    DomainSocket(#[from] DomainSocketError),
    /// A standby met somebody who has the lock of the domain, and whom nobody can connect to.
    #[error(
        "cannot connect to the Manager that holds {path:?}, and cannot take its place: {source}"
    )]
    NobodyServes {
        /// The socket's path.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// The operating system refused what every Manager needs.
    #[error("cannot {action}: {source}")]
    Io {
        /// What was tried.
        action: &'static str,
        /// What it said.
        source: io::Error,
    },
}

impl StartError {
    pub(crate) fn io(action: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { action, source }
    }
}

/// The loop cannot go on. Links live on without their Manager.
#[derive(Debug, thiserror::Error)]
#[error("the Manager cannot wait for events any more: {0}")]
pub struct RunError(#[from] io::Error);

/// What ended a Manager's loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// A [`Stopper`](crate::Stopper).
    Stopped,
    /// Another Manager has taken its place (SM2-RES-010).
    HandedOver,
}
