//! Listening sockets.

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};

use nix::errno::Errno;
use nix::libc;

use crate::socket::{SeqPacket, address, adopt};
use crate::syscall::fork::Unforked;
use crate::syscall::sockets::{self, sockopt};

/// A listening `AF_UNIX` `SOCK_SEQPACKET` socket, close-on-exec, non-blocking.
///
/// A child that this process makes by `fork(2)` keeps neither the listener nor the connections that it accepts: they
/// end with this process.
#[derive(Debug)]
pub struct Listener {
    unforked: Unforked,
    fd: OwnedFd,
}

impl Listener {
    /// Binds `path`, which must not exist yet, and listens with room for
    /// `backlog` connections that are not accepted yet (at most `net.core.somaxconn`).
    ///
    /// The socket's file stays when the listener is dropped:
    /// [`BindOptions`](crate::BindOptions) bind a path that is cleaned up.
    ///
    /// # Errors
    ///
    /// Any error of `bind(2)` and `listen(2)`, among them `AddrInUse`: the path exists.
    /// `InvalidInput` for a path that is empty or too long.
    pub fn bind(path: &Path, backlog: u32) -> io::Result<Self> {
        let address = address(path)?;
        let fd = sockets::seqpacket()?;
        sockets::bind(fd.as_fd(), &address)?;
        let listener = Self::new(fd);
        listener.listen(backlog)?;
        Ok(listener)
    }

    fn new(fd: OwnedFd) -> Self {
        Self {
            unforked: Unforked::new(fd.as_fd()),
            fd,
        }
    }

    /// Listens with this backlog from now on. The kernel records the calling process as the one
    /// that peers see in `SO_PEERCRED`.
    pub(crate) fn listen(&self, backlog: u32) -> io::Result<()> {
        let most = u32::try_from(libc::SOMAXCONN).unwrap_or(0);
        let backlog = i32::try_from(backlog.min(most)).unwrap_or(libc::SOMAXCONN);
        Ok(sockets::listen(self.fd.as_fd(), backlog)?)
    }

    /// The path that the socket was bound to; `None` for an abstract name.
    #[must_use]
    pub fn path(&self) -> Option<PathBuf> {
        let address = sockets::unix_name(&self.fd).ok()?;
        address.path().map(Path::to_owned)
    }

    /// Takes ownership of a listening socket, such as one from socket activation.
    ///
    /// # Errors
    ///
    /// `InvalidInput` if it is not a listening `AF_UNIX` `SOCK_SEQPACKET` socket;
    /// it is closed then.
    pub fn from_fd(fd: OwnedFd) -> io::Result<Self> {
        let fd = adopt(fd)?;
        if sockets::get_option(&fd, sockopt::AcceptConn)? {
            Ok(Self::new(fd))
        } else {
            Err(io::ErrorKind::InvalidInput.into())
        }
    }

    /// Accepts the next connection; `None` if the backlog is empty.
    ///
    /// # Errors
    ///
    /// Any error of `accept(2)`. After `EMFILE` (too many open descriptors) the connection stays in
    /// the backlog and the listener stays readable, so an event loop should stop watching the
    /// listener until it has closed a descriptor.
    pub fn accept(&self) -> io::Result<Option<SeqPacket>> {
        loop {
            match sockets::accept(self.fd.as_fd()) {
                Ok(fd) => return Ok(Some(SeqPacket::accepted(fd))),
                Err(Errno::EAGAIN) => return Ok(None),
                Err(Errno::EINTR | Errno::ECONNABORTED) => {}
                Err(errno) => return Err(errno.into()),
            }
        }
    }
}

impl AsFd for Listener {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.fd.as_fd()
    }
}

impl From<Listener> for OwnedFd {
    fn from(listener: Listener) -> Self {
        drop(listener.unforked);
        listener.fd
    }
}
