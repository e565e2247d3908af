//! What comes of sending or receiving one datagram.

use std::io;
use std::os::fd::OwnedFd;

use nix::errno::Errno;

/// One datagram, received.
#[derive(Debug)]
pub struct Received {
    /// How many bytes of the buffer were filled.
    pub len: usize,
    /// The descriptors that came along, in the sender's order.
    pub fds: ReceivedFds,
    /// The datagram was longer than the buffer; the rest is lost.
    pub data_truncated: bool,
    /// Some descriptors could not be delivered, because this process has
    /// too many open already.
    pub control_truncated: bool,
}

/// Received descriptors: owned, so dropping them closes them.
#[derive(Debug, Default)]
pub struct ReceivedFds(Vec<OwnedFd>);

impl ReceivedFds {
    pub(crate) const fn new(fds: Vec<OwnedFd>) -> Self {
        Self(fds)
    }

    /// How many there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether none came.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// To look at them before deciding to keep them.
    pub fn iter(&self) -> std::slice::Iter<'_, OwnedFd> {
        self.0.iter()
    }

    /// Takes them all.
    #[must_use]
    pub fn into_vec(self) -> Vec<OwnedFd> {
        self.0
    }
}

impl IntoIterator for ReceivedFds {
    type Item = OwnedFd;
    type IntoIter = std::vec::IntoIter<OwnedFd>;

    fn into_iter(self) -> Self::IntoIter {
        self.0.into_iter()
    }
}

impl<'a> IntoIterator for &'a ReceivedFds {
    type Item = &'a OwnedFd;
    type IntoIter = std::slice::Iter<'a, OwnedFd>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}

/// Why a datagram was not sent. Nothing of it was.
#[derive(Debug, thiserror::Error)]
pub enum SendError {
    /// No room right now; wait until the socket is writable.
    #[error("the socket is full: wait until it is writable")]
    WouldBlock,
    /// The peer is gone, or stopped reading for good.
    #[error("the peer has closed the connection")]
    Closed,
    /// Too many descriptors of this user are in flight, because a receiver does
    /// not fetch them. Not a fault of the sender: disconnect that receiver.
    #[error("too many descriptors in flight: the receiver does not read")]
    TooManyInFlight,
    /// The datagram is larger than the socket's send buffer can ever hold, or
    /// has more than 1024 parts.
    #[error("the datagram is too long for the socket")]
    TooLong,
    /// Anything else.
    #[error("cannot send: {0}")]
    Io(#[source] io::Error),
}

impl From<Errno> for SendError {
    fn from(errno: Errno) -> Self {
        match errno {
            Errno::EAGAIN => Self::WouldBlock,
            Errno::EPIPE | Errno::ECONNRESET | Errno::ENOTCONN => Self::Closed,
            Errno::ETOOMANYREFS => Self::TooManyInFlight,
            Errno::EMSGSIZE => Self::TooLong,
            // ENOBUFS and ENOMEM are not `WouldBlock`: the kernel is short of memory while
            // the socket may well be writable, so waiting for that would spin.
            other => Self::Io(other.into()),
        }
    }
}

/// Why no datagram was received.
#[derive(Debug, thiserror::Error)]
pub enum RecvError {
    /// Nothing there right now; wait until the socket is readable.
    #[error("no datagram is waiting")]
    WouldBlock,
    /// The peer is gone, and all that it had sent has been received.
    #[error("the peer has closed the connection")]
    Closed,
    /// Anything else.
    #[error("cannot receive: {0}")]
    Io(#[source] io::Error),
}

impl From<Errno> for RecvError {
    fn from(errno: Errno) -> Self {
        match errno {
            Errno::EAGAIN => Self::WouldBlock,
            Errno::ENOTCONN => Self::Closed,
            other => Self::Io(other.into()),
        }
    }
}
