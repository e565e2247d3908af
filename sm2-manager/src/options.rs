//! The options of a Manager, and its errors.

use std::{io, path::PathBuf};

use sm2_io::{BindOptions, DomainSocketError};
use sm2_proto::control::{LimitError, Limits};

use crate::PolicyFileError;

/// Options of a Manager.
#[derive(Clone, Debug)]
pub struct Options {
    /// Limits, and which links are sealed.
    pub limits: Limits,
    /// The socket's permission bits: a process needs write permission to connect. Has no effect on an adopted
    /// socket (socket activation).
    pub socket_mode: u32,
    /// The access policy of the domain: the Manager makes `<path>.policy` a symbolic link to this file. `None`
    /// uses `<path>.policy` as it is; without such a file everything is allowed.
    pub policy_file: Option<PathBuf>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            limits: Limits::default(),
            socket_mode: 0o600,
            policy_file: None,
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

/// The reason why a Manager did not start.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StartError {
    /// A limit is wrong.
    #[error(transparent)]
    Limit(#[from] LimitError),
    /// The domain's socket cannot be claimed.
    #[error(transparent)]
    DomainSocket(#[from] DomainSocketError),
    /// Another process holds the domain's lock, but does not accept connections.
    #[error(
        "another process holds the lock of {path:?} but does not accept connections: {source}; end that \
         process, or choose another domain"
    )]
    NobodyServes {
        /// The socket's path.
        path: PathBuf,
        /// The error of connecting.
        r#source: io::Error,
    },
    /// The domain has an access policy that cannot be used. A Manager without it would allow everything.
    #[error("{0}; the Manager does not serve without the access policy of its domain")]
    Policy(PolicyFileError),
    /// The operating system refused a resource that every Manager needs.
    #[error("cannot {action}: {source}")]
    Io {
        /// The action that failed.
        action: &'static str,
        /// The error of the operating system.
        r#source: io::Error,
    },
}

impl StartError {
    pub(crate) fn io(action: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { action, source }
    }
}

/// The loop cannot continue. Links stay open without their Manager.
#[derive(Debug, thiserror::Error)]
#[error("the Manager stopped, because waiting for events failed: {0}")]
pub struct RunError(pub io::Error);

/// The reason why a Manager's loop ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// A [`Stopper`](crate::Stopper) ended it.
    Stopped,
    /// Another Manager has taken over (SM2-RES-009).
    HandedOver,
}
