//! A domain's socket that this process owns, and handing it over to a successor.

use std::path::Path;

use super::error::DomainSocketError;
use super::lock::DomainLock;
use super::socket_file::SocketFile;
use crate::socket::Listener;

/// A domain's socket that this process owns and listens on. Dropping it removes its files.
#[derive(Debug)]
pub struct DomainSocket {
    pub(super) file: SocketFile,
    pub(super) listener: Listener,
    /// Last, so that the lock is released after the other fields are dropped.
    pub(super) lock: DomainLock,
}

impl DomainSocket {
    /// The listener that accepts connections.
    #[must_use]
    pub const fn listener(&self) -> &Listener {
        &self.listener
    }

    /// The path of the socket.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.lock.path()
    }

    /// Releases the lock, so that a successor can take it and replace the socket. Until then the socket
    /// stays in place and this process keeps listening.
    //= SM2-RES-009
    #[must_use = "dropping it ends listening"]
    pub fn hand_over(self) -> UnlockedSocket {
        let Self {
            file,
            listener,
            lock,
        } = self;
        let unlocked = UnlockedSocket::new(file, listener);
        lock.leave();
        unlocked
    }

    /// Stops listening and removes the files: the same as dropping.
    pub fn close(self) {}
}

/// A domain's socket without its lock, which keeps listening until a successor replaces it.
///
/// The successor takes the lock, and then replaces the socket in one step. Until that step, connections
/// arrive here, also while the successor holds the lock; after it, this process still has to accept the
/// connections in the backlog.
///
/// Dropping it ends listening. If no successor has come, that removes the files as for a
/// [`DomainSocket`]; it leaves the files of a successor alone, and those that a successor is about to replace.
#[derive(Debug)]
pub struct UnlockedSocket {
    file: SocketFile,
    listener: Listener,
}

impl UnlockedSocket {
    /// Called before the lock is released.
    fn new(file: SocketFile, listener: Listener) -> Self {
        let file = file.unlocked();
        Self { file, listener }
    }

    /// The listener that accepts connections until the socket is replaced.
    #[must_use]
    pub const fn listener(&self) -> &Listener {
        &self.listener
    }

    /// The path of the socket when it was handed over.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Whether the path no longer names this socket: a successor has replaced it, and may have removed
    /// its own since. No new connection can arrive then.
    //= SM2-RES-009
    #[must_use]
    pub fn is_replaced(&self) -> bool {
        !self.file.is_there()
    }

    /// Takes the lock again and owns the socket as before, if no successor has come.
    ///
    /// # Errors
    ///
    /// [`NotReclaimed`], which gives the hand-over back. Its reason is
    /// [`DomainSocketError::Busy`] while another process holds the lock,
    /// [`DomainSocketError::Replaced`] if another process has held it: see
    /// [`is_replaced`](Self::is_replaced). Others as [`DomainLock::acquire`].
    //= SM2-RES-009
    pub fn reclaim(self) -> Result<DomainSocket, Box<NotReclaimed>> {
        let not = |socket, reason| Err(Box::new(NotReclaimed { socket, reason }));
        let lock = match DomainLock::acquire(self.path()) {
            Ok(lock) => lock,
            Err(reason) => return not(self, reason),
        };
        // With the lock held, no other process can change that.
        if self.is_replaced() {
            let path = self.path().to_owned();
            return not(self, DomainSocketError::Replaced { path });
        }
        Ok(DomainSocket {
            file: self.file.locked(),
            listener: self.listener,
            lock,
        })
    }
}

/// Why a domain's socket was not reclaimed.
#[derive(Debug, thiserror::Error)]
#[error("cannot take the socket back: {reason}")]
pub struct NotReclaimed {
    /// The socket as it was before, still listening.
    pub socket: UnlockedSocket,
    /// The reason.
    pub reason: DomainSocketError,
}
