//! Binding a domain's socket.

use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

use super::error::DomainSocketError;
use super::files::{Identity, failed, with_suffix};
use super::lock::DomainLock;
use super::owned::DomainSocket;
use super::socket_file::{SocketFile, Whose};
use crate::socket::Listener;
use crate::syscall::files as fs;

/// How to bind a domain's socket.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BindOptions {
    /// Permission bits of the socket: a peer needs write permission to connect. The umask does not
    /// apply. 0600 by default.
    pub mode: u32,
    /// The number of connections that may wait to be accepted. 128 by default.
    pub backlog: u32,
}

impl Default for BindOptions {
    fn default() -> Self {
        Self {
            mode: 0o600,
            backlog: 128,
        }
    }
}

impl BindOptions {
    /// Binds `path` with the defaults. See [`acquire_at`](Self::acquire_at).
    ///
    /// # Errors
    ///
    /// As [`acquire_at`](Self::acquire_at).
    pub fn acquire(path: &Path) -> Result<DomainSocket, DomainSocketError> {
        Self::default().acquire_at(path)
    }

    /// Becomes the owner of `path`, and listens there.
    ///
    /// Creates the directory (0700) if it does not exist, but not its parent. Atomically replaces a
    /// socket that a dead owner left.
    ///
    /// # Errors
    ///
    /// [`DomainSocketError::Busy`] if another process owns it; the other kinds say what is wrong with
    /// the path.
    pub fn acquire_at(self, path: &Path) -> Result<DomainSocket, DomainSocketError> {
        DomainLock::acquire(path)?.bind(self)
    }

    /// Becomes the owner of the path of a bound socket, and listens with that socket:
    /// socket activation.
    ///
    /// The process that made the socket owns its file, so this one neither changes its mode nor removes
    /// it. From now on, peers that connect see this process as the listener
    /// ([`SeqPacket::peer_credentials`](crate::SeqPacket::peer_credentials)).
    ///
    /// # Errors
    ///
    /// [`DomainSocketError::NotAListener`]; [`DomainSocketError::NoPath`] if it is bound to no path,
    /// or to one that depends on a current directory; and as
    /// [`acquire_at`](Self::acquire_at), among them [`DomainSocketError::Busy`]. The socket is
    /// closed then.
    //= SM2-TRN-007
    pub fn adopt(self, socket: OwnedFd) -> Result<DomainSocket, DomainSocketError> {
        let listener = Listener::from_fd(socket)
            .map_err(|source| DomainSocketError::NotAListener { source })?;
        let path = (listener.path())
            .filter(|path| path.is_absolute())
            .ok_or(DomainSocketError::NoPath)?;
        let lock = DomainLock::acquire(&path)?;
        let found = fs::symlink_metadata(&path).map_err(failed("look at", &path))?;
        if !found.file_type().is_socket() {
            return Err(DomainSocketError::NotASocket { path });
        }
        (listener.listen(self.backlog)).map_err(failed("listen at", &path))?;
        Ok(DomainSocket {
            file: SocketFile::new(&path, Identity::of(&found), Whose::SomebodyElses),
            listener,
            lock,
        })
    }
}

impl DomainLock {
    /// Binds the socket and listens.
    ///
    /// # Errors
    ///
    /// [`DomainSocketError::NotASocket`], [`DomainSocketError::Io`].
    pub fn bind(self, claim: BindOptions) -> Result<DomainSocket, DomainSocketError> {
        let path = self.path();
        match fs::symlink_metadata(path) {
            Ok(found) if !found.file_type().is_socket() => {
                let path = path.to_owned();
                return Err(DomainSocketError::NotASocket { path });
            }
            _ => {}
        }
        // Bound under a temporary name and renamed when it is ready: no peer finds a socket that does
        // not listen yet, or whose permissions are not set yet.
        let fresh = with_suffix(path, "~");
        match fs::remove(&fresh) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(failed("remove", &fresh)(error));
            }
            _ => {}
        }
        let listener =
            Listener::bind(&fresh, claim.backlog).map_err(failed("bind a socket at", &fresh))?;
        let publish = || {
            fs::set_mode(&fresh, claim.mode & 0o777)?;
            let identity = Identity::of(&fs::symlink_metadata(&fresh)?);
            fs::rename(&fresh, path)?;
            Ok(identity)
        };
        match publish() {
            Ok(identity) => Ok(DomainSocket {
                file: SocketFile::new(path, identity, Whose::Ours),
                listener,
                lock: self,
            }),
            Err(error) => {
                let _ = fs::remove(&fresh);
                Err(failed("publish the socket at", path)(error))
            }
        }
    }
}
