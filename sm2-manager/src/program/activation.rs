//! Socket activation: the socket that a service manager passes, and the status that it is told.

use std::{io, os::fd::OwnedFd};

use listenfd::ListenFd;
use nix::libc::{AF_UNIX, SOCK_SEQPACKET};
use sd_notify::NotifyState;
use tracing::debug;

/// The sockets that the service manager passed cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ActivationError {
    /// More than one socket was passed.
    #[error(
        "{count} sockets were handed over (LISTEN_FDS), and a Manager serves one: use one socket unit with \
         one ListenSequentialPacket= line"
    )]
    Count {
        /// How many were passed.
        count: usize,
    },
    /// The socket is of the wrong kind.
    #[error(
        "the socket that was handed over is of the wrong kind: use ListenSequentialPacket= in the socket unit \
         ({0})"
    )]
    Kind(io::Error),
}

/// Returns the listening socket that the service manager passed by the protocol of `sd_listen_fds(3)`, if
/// any.
pub(super) fn socket() -> Result<Option<OwnedFd>, ActivationError> {
    let mut fds = ListenFd::from_env();
    let count = fds.len();
    if count > 1 {
        return Err(ActivationError::Count { count });
    }
    fds.take_custom(0, AF_UNIX, SOCK_SEQPACKET, "Unix seqpacket socket")
        .map_err(ActivationError::Kind)
}

/// Sends states to the service manager as `sd_notify(3)` does, if one listens.
pub(super) fn tell(states: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(states) {
        debug!(%error, "cannot report the state to the service manager");
    }
}
