//! Unix seqpacket sockets: datagrams with the descriptors that belong to them.
//!
//! Frames, queues and retries after a full buffer belong to the callers, the drivers of `sm2-node`
//! and `sm2-manager`.

use std::io::{self, IoSlice};
use std::os::fd::{AsFd, BorrowedFd, FromRawFd, OwnedFd};
use std::path::Path;

use nix::errno::Errno;
use nix::libc;

use crate::cmsg::{ControlBuffer, ControlMessage};
pub use crate::datagram::{Received, ReceivedFds, RecvError, SendError};
pub use crate::listener::Listener;
use crate::syscall::fork::Unforked;
use crate::syscall::sockets::{self, UnixAddr, sockopt};

/// A connected `AF_UNIX` `SOCK_SEQPACKET` socket, close-on-exec, non-blocking.
///
/// Sending and receiving take `&self`: the kernel serialises them.
#[derive(Debug)]
pub struct SeqPacket {
    /// Of an accepted connection, so that it ends with the process that serves it.
    unforked: Option<Unforked>,
    fd: OwnedFd,
}

impl SeqPacket {
    /// Connects to the listener at `path`. Never blocks: the kernel completes the connection before
    /// the listener accepts it, or refuses it at once.
    ///
    /// # Errors
    ///
    /// Any error of `socket(2)` and `connect(2)`, among them `NotFound` (no such path),
    /// `ConnectionRefused` (nobody listens there any more), `PermissionDenied`, and `WouldBlock`:
    /// the listener's backlog is full. No connection is pending then, and no event announces room:
    /// try again later. `InvalidInput` for a path that is empty or too long for a socket address.
    pub fn connect(path: &Path) -> io::Result<Self> {
        let address = address(path)?;
        let fd = sockets::seqpacket()?;
        sockets::connect(fd.as_fd(), &address)?;
        Ok(Self::new(fd))
    }

    /// Makes two sockets that are connected with each other.
    ///
    /// # Errors
    ///
    /// Any error of `socketpair(2)`, such as too many descriptors or no memory.
    pub fn pair() -> io::Result<(Self, Self)> {
        let (a, b) = sockets::seqpacket_pair()?;
        Ok((Self::new(a), Self::new(b)))
    }

    /// Takes ownership of a descriptor, such as one that came with a message.
    ///
    /// # Errors
    ///
    /// `InvalidInput` if it is not an `AF_UNIX` `SOCK_SEQPACKET` socket; it
    /// is closed then. A socket that is not connected answers `Closed` when it is used.
    pub fn from_fd(fd: OwnedFd) -> io::Result<Self> {
        Ok(Self::new(adopt(fd)?))
    }

    const fn new(fd: OwnedFd) -> Self {
        Self { unforked: None, fd }
    }

    /// A connection that a listener has just accepted, with both flags set.
    pub(crate) fn accepted(fd: OwnedFd) -> Self {
        Self {
            unforked: Some(Unforked::new(fd.as_fd())),
            fd,
        }
    }

    /// The process at the other end when the connection was made (`SO_PEERCRED`).
    ///
    /// The side that connected sees the process that called `listen(2)` last, which need not be the
    /// one that accepts. Both ends of a [pair](Self::pair) see the process that made the pair.
    ///
    /// # Errors
    ///
    /// Any error of `getsockopt(2)`.
    pub fn peer_credentials(&self) -> io::Result<PeerCredentials> {
        let peer = sockets::get_option(&self.fd, sockopt::PeerCredentials)?;
        Ok(PeerCredentials {
            uid: peer.uid(),
            gid: peer.gid(),
            pid: peer.pid(),
        })
    }

    /// The further groups of that process (`SO_PEERGROUPS`), beside the group of its credentials.
    ///
    /// # Errors
    ///
    /// Any error of `getsockopt(2)`; Linux before 4.13 does not know the option.
    pub fn peer_groups(&self) -> io::Result<Vec<u32>> {
        let mut gids: Vec<libc::gid_t> = vec![0; 32];
        loop {
            match sockets::peer_groups(self.fd.as_fd(), &mut gids)? {
                (count, true) => {
                    gids.truncate(count);
                    return Ok(gids);
                }
                // The kernel states how many there are.
                (count, false) => gids.resize(count, 0),
            }
        }
    }

    /// Asks for `bytes` of send buffer for datagrams that the peer has not read (`SO_SNDBUF`).
    ///
    /// The kernel doubles the number for its own bookkeeping, and caps it
    /// at `net.core.wmem_max` without an error.
    ///
    /// # Errors
    ///
    /// Any error of `setsockopt(2)`.
    pub fn set_send_buffer_bytes(&self, bytes: usize) -> io::Result<()> {
        Ok(sockets::set_option(&self.fd, sockopt::SndBuf, &bytes)?)
    }

    /// The memory of sent datagrams that the peer has not read (`SIOCOUTQ`): several hundred bytes
    /// of overhead for each datagram, 0 if the peer has read all of them.
    ///
    /// # Errors
    ///
    /// None is expected of a connected socket.
    pub fn unread_bytes(&self) -> io::Result<usize> {
        let bytes = sockets::unread_bytes(self.fd.as_fd())?;
        Ok(usize::try_from(bytes).unwrap_or(0))
    }

    /// Ends the connection in both directions, also for duplicates of this
    /// descriptor elsewhere. Queued datagrams are still delivered to the peer.
    ///
    /// # Errors
    ///
    /// `NotConnected`; none other is expected.
    pub fn shutdown(&self) -> io::Result<()> {
        Ok(sockets::shutdown(self.fd.as_fd())?)
    }

    /// Sends the concatenation of `parts` as one datagram with `fds`.
    ///
    /// Sends all of it or nothing; never blocks, never raises `SIGPIPE`, and does not allocate. The
    /// kernel duplicates the descriptors: the caller keeps its own.
    ///
    /// # Errors
    ///
    /// See [`SendError`]. `InvalidInput` for a datagram without any byte, since the receiver could
    /// not tell it from the end of the connection, and for more than 253 descriptors.
    pub fn send(&self, parts: &[IoSlice<'_>], fds: &[BorrowedFd<'_>]) -> Result<(), SendError> {
        if parts.iter().all(|part| part.is_empty()) {
            return Err(SendError::Io(io::ErrorKind::InvalidInput.into()));
        }
        let mut header = empty_header();
        header.msg_iov = parts.as_ptr().cast::<libc::iovec>().cast_mut();
        header.msg_iovlen = parts.len() as _;

        let mut control;
        if !fds.is_empty() {
            let (rights, len) = ControlBuffer::rights(fds)
                .ok_or(SendError::Io(io::ErrorKind::InvalidInput.into()))?;
            control = rights;
            header.msg_control = control.as_mut_ptr();
            header.msg_controllen = len as _;
        }
        let flags = libc::MSG_NOSIGNAL | libc::MSG_DONTWAIT;
        loop {
            // SAFETY: `header` points to `parts.len()` iovecs (std promises that `IoSlice` has the
            // layout of `iovec`) and to `len` initialised bytes of `control`, or to no control
            // data. All of them outlive the call, and `sendmsg` only reads them.
            let sent = unsafe { sockets::sendmsg(self.fd.as_fd(), &header, flags) };
            match sent {
                Ok(()) => return Ok(()),
                Err(Errno::EINTR) => {}
                Err(errno) => return Err(errno.into()),
            }
        }
    }

    /// Receives one datagram into `buffer`, with its descriptors.
    ///
    /// Never blocks. The result owns every descriptor that the kernel installed (close-on-exec), so
    /// dropping the result closes them, also if the datagram was truncated. Allocates only if
    /// descriptors came.
    ///
    /// Datagrams that a peer sent before it closed are delivered first, then `Closed`.
    ///
    /// # Errors
    ///
    /// See [`RecvError`]. An empty datagram counts as `Closed`.
    pub fn recv(&self, buffer: &mut [u8]) -> Result<Received, RecvError> {
        let mut control = ControlBuffer::empty();
        let mut part = libc::iovec {
            iov_base: buffer.as_mut_ptr().cast(),
            iov_len: buffer.len(),
        };
        let mut header = empty_header();
        header.msg_iov = &raw mut part;
        header.msg_iovlen = 1;
        let flags = libc::MSG_DONTWAIT | libc::MSG_CMSG_CLOEXEC;
        let len = loop {
            header.msg_control = control.as_mut_ptr();
            header.msg_controllen = ControlBuffer::ROOM as _;
            // SAFETY: `header` points to `buffer` and `control` with their true sizes; this function
            // borrows both exclusively, and they outlive the call.
            let got = unsafe { sockets::recvmsg(self.fd.as_fd(), &mut header, flags) };
            match got {
                Ok(len) => break len,
                Err(Errno::EINTR) => {}
                // The peer closed without having read all datagrams from this side. The kernel
                // reports that once, *before* it delivers the datagrams of the peer. The next call
                // returns one of those, or the end of the stream.
                Err(Errno::ECONNRESET) => {}
                Err(errno) => return Err(errno.into()),
            }
        };
        #[allow(
            clippy::unnecessary_cast,
            reason = "the type differs between C libraries"
        )]
        let control_len = header.msg_controllen as usize;
        // Before any return: every installed descriptor needs an owner.
        let fds = own_fds(&control, control_len);
        let data_truncated = header.msg_flags & libc::MSG_TRUNC != 0;
        if len == 0 && !data_truncated {
            return Err(RecvError::Closed);
        }
        Ok(Received {
            len,
            fds,
            data_truncated,
            control_truncated: header.msg_flags & libc::MSG_CTRUNC != 0,
        })
    }
}

/// Takes ownership of every descriptor in `control`. Returns those that the sender passed, and
/// closes one that the kernel added (a pidfd, if the maker of the socket asked for it).
fn own_fds(control: &ControlBuffer, len: usize) -> ReceivedFds {
    let count = |message: ControlMessage<'_>| message.is_rights().then(|| message.fds().len());
    let room = control.messages(len).filter_map(count).sum();
    let mut fds = Vec::with_capacity(room);
    for message in control.messages(len) {
        let passed = message.is_rights();
        for number in message.fds().filter(|&number| number >= 0) {
            // SAFETY: the one `recvmsg` call that filled this buffer wrote the number: it is a new,
            // open descriptor that nothing else owns, and the loop visits each number once.
            let fd = unsafe { OwnedFd::from_raw_fd(number) };
            if passed {
                fds.push(fd);
            }
        }
    }
    ReceivedFds::new(fds)
}

fn empty_header() -> libc::msghdr {
    // SAFETY: `msghdr` is a C struct of integers and pointers (with private padding on some
    // targets); all zeroes are a valid value: no name, no data, no control data.
    unsafe { std::mem::zeroed() }
}

pub(crate) fn address(path: &Path) -> io::Result<UnixAddr> {
    if path.as_os_str().is_empty() {
        // An empty name would make the kernel choose an abstract one.
        return Err(io::ErrorKind::InvalidInput.into());
    }
    UnixAddr::new(path).map_err(|_| io::ErrorKind::InvalidInput.into())
}

/// Checks that `fd` is a Unix seqpacket socket, and sets the two flags.
pub(crate) fn adopt(fd: OwnedFd) -> io::Result<OwnedFd> {
    let seqpacket = sockets::is_seqpacket(&fd) == Ok(true);
    // `getsockname` fails here for an address of any other family.
    let unix = sockets::unix_name(&fd).is_ok();
    if !(seqpacket && unix) {
        return Err(io::ErrorKind::InvalidInput.into());
    }
    sockets::set_flags(&fd)?;
    Ok(fd)
}

impl AsFd for SeqPacket {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }
}

impl From<SeqPacket> for OwnedFd {
    fn from(socket: SeqPacket) -> Self {
        drop(socket.unforked);
        socket.fd
    }
}

/// The credentials of a peer, as the kernel recorded them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PeerCredentials {
    /// Effective user id; 65534 if it has no meaning in our user namespace.
    pub uid: u32,
    /// Effective group id.
    pub gid: u32,
    /// Process id; 0 if the process is not visible in our pid namespace.
    pub pid: i32,
}
