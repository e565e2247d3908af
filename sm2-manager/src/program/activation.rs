//! What the service manager handed over, and what it is told.

use std::{io, os::fd::OwnedFd};

use listenfd::ListenFd;
use nix::libc::{AF_UNIX, SOCK_SEQPACKET};
use sd_notify::NotifyState;
use tracing::debug;

/// What was handed over is of no use.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ActivationError {
    /// More than one socket.
    #[error(
        "{count} sockets were handed over (LISTEN_FDS), and a Manager serves one: use one socket unit with one ListenSequentialPacket= line"
    )]
    Count {
        /// How many there were.
        count: usize,
    },
    /// Another kind of socket.
    #[error(
        "the socket that was handed over is of the wrong kind: use ListenSequentialPacket= in the socket unit ({0})"
    )]
    Kind(#[source] io::Error),
}

/// The listening socket that was handed over by the protocol of `sd_listen_fds(3)`, if any.
pub(super) fn socket() -> Result<Option<OwnedFd>, ActivationError> {
    let mut fds = ListenFd::from_env();
    let count = fds.len();
    if count > 1 {
        return Err(ActivationError::Count { count });
    }
    fds.take_custom(0, AF_UNIX, SOCK_SEQPACKET, "Unix seqpacket socket")
        .map_err(ActivationError::Kind)
}

/// Tells it, as `sd_notify(3)` does, if it listens.
pub(super) fn tell(states: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(states) {
        debug!(%error, "cannot tell the service manager");
    }
}
