//! The results of sending and receiving one datagram.

use std::io;
use std::os::fd::OwnedFd;

use nix::errno::Errno;

/// A received datagram.
#[derive(Debug)]
pub struct Received {
    /// How many bytes of the buffer were filled.
    pub len: usize,
    /// The descriptors that came along, in the sender's order.
    pub fds: ReceivedFds,
    /// Whether the datagram was longer than the buffer; the rest is lost.
    pub data_truncated: bool,
    /// Whether the kernel dropped descriptors, because this process has too many open already. There
    /// is always room for all that a datagram can carry, so the sender is not to blame.
    pub control_truncated: bool,
}

/// The descriptors that came with a datagram. Dropping the value closes them.
#[derive(Debug, Default)]
pub struct ReceivedFds(Vec<OwnedFd>);

impl ReceivedFds {
    pub(crate) const fn new(fds: Vec<OwnedFd>) -> Self {
        Self(fds)
    }

    /// The number of descriptors.
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether no descriptor came.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Iterates over the descriptors without taking them.
    pub fn iter(&self) -> std::slice::Iter<'_, OwnedFd> {
        self.0.iter()
    }

    /// Takes all descriptors.
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

/// Why a datagram was not sent. No part of the datagram was sent.
#[derive(Debug, thiserror::Error)]
pub enum SendError {
    /// The queue is full: wait until the socket is writable.
    #[error("the socket is full: wait until it is writable")]
    WouldBlock,
    /// The peer has closed the connection, or will never read again.
    #[error("the peer has closed the connection")]
    Closed,
    /// Too many descriptors of this user are in flight, because some receiver does not read them. It
    /// may be another one than the addressed one (SM2-TRN-009).
    #[error("too many descriptors in flight: some receiver does not read them")]
    TooManyInFlight,
    /// The datagram is larger than the socket's send buffer can ever hold, or
    /// has more than 1024 parts.
    #[error("the datagram is too long for the socket")]
    TooLong,
    /// Anything else.
    #[error("cannot send: {0}")]
    Io(io::Error),
}

impl From<Errno> for SendError {
    fn from(errno: Errno) -> Self {
        match errno {
            Errno::EAGAIN => Self::WouldBlock,
            Errno::EPIPE | Errno::ECONNRESET | Errno::ENOTCONN => Self::Closed,
            Errno::ETOOMANYREFS => Self::TooManyInFlight,
            Errno::EMSGSIZE => Self::TooLong,
            // ENOBUFS and ENOMEM are not `WouldBlock`: the socket may be writable while the kernel
            // is short of memory, so a caller that waits until it is writable would spin.
            other => Self::Io(other.into()),
        }
    }
}

/// Why no datagram was received.
#[derive(Debug, thiserror::Error)]
pub enum RecvError {
    /// No datagram is queued: wait until the socket is readable.
    #[error("no datagram is waiting")]
    WouldBlock,
    /// The peer has closed the connection, and every datagram that it sent has been received.
    #[error("the peer has closed the connection")]
    Closed,
    /// Anything else.
    #[error("cannot receive: {0}")]
    Io(io::Error),
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
