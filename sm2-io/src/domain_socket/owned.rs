//! A domain's socket that this process owns, and handing it over to a successor.

use std::path::Path;

use super::error::DomainSocketError;
use super::lock::DomainLock;
use super::socket_file::SocketFile;
use crate::socket::Listener;

/// A domain's socket, owned and listening. Dropping it removes its files.
#[derive(Debug)]
pub struct DomainSocket {
    pub(super) file: SocketFile,
    pub(super) listener: Listener,
    /// Last, so that it is given up when all else is gone.
    pub(super) lock: DomainLock,
}

impl DomainSocket {
    /// Where connections arrive.
    #[must_use]
    pub const fn listener(&self) -> &Listener {
        &self.listener
    }

    /// Where the socket is.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.lock.path()
    }

    /// Gives up the lock, so that a successor can take it and replace the socket; until
    /// it does, the socket stays where it is and this process goes on listening.
    //= SM2-RES-010
    #[must_use = "dropping it ends listening"]
    pub fn hand_over(self) -> HandOver {
        let Self {
            file,
            listener,
            lock,
        } = self;
        let hand_over = HandOver::new(file, listener);
        lock.leave();
        hand_over
    }

    /// Stops listening and removes the files: the same as dropping.
    pub fn close(self) {}
}

/// A domain's socket whose lock was given up, and that goes on listening until somebody
/// takes its place.
///
/// The successor takes the lock, and then replaces the socket in one step. Before that,
/// connections arrive here, also while the successor has the lock already; after it,
/// those that wait in the backlog are still to be accepted here.
///
/// Dropping it ends listening. If nobody has come, it removes its files like an
/// [`DomainSocket`]; it leaves alone what a successor has, or is about to replace.
#[derive(Debug)]
pub struct HandOver {
    file: SocketFile,
    listener: Listener,
}

impl HandOver {
    /// Before the lock is given up.
    fn new(file: SocketFile, listener: Listener) -> Self {
        let file = file.unlocked();
        Self { file, listener }
    }

    /// Where connections arrive until the socket is replaced.
    #[must_use]
    pub const fn listener(&self) -> &Listener {
        &self.listener
    }

    /// Where the socket was when it was handed over.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Whether the path names this socket no longer: a successor has put its own there, or
    /// has even removed that since. No new connection can arrive then.
    //= SM2-RES-010
    #[must_use]
    pub fn is_replaced(&self) -> bool {
        !self.file.is_there()
    }

    /// Takes the lock again and is what it was before, if nobody has come.
    ///
    /// # Errors
    ///
    /// [`NotReclaimed`], which gives the hand-over back. Its reason is
    /// [`DomainSocketError::Busy`] while somebody has the lock,
    /// [`DomainSocketError::Replaced`] if somebody had it: see
    /// [`is_replaced`](Self::is_replaced). Others as [`DomainLock::acquire`].
    //= SM2-RES-010
    pub fn reclaim(self) -> Result<DomainSocket, Box<NotReclaimed>> {
        let not = |hand_over, reason| Err(Box::new(NotReclaimed { hand_over, reason }));
        let lock = match DomainLock::acquire(self.path()) {
            Ok(lock) => lock,
            Err(reason) => return not(self, reason),
        };
        // Nobody else can change that any more.
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

/// Why a domain's socket was not taken back.
#[derive(Debug, thiserror::Error)]
#[error("cannot take the socket back: {reason}")]
pub struct NotReclaimed {
    /// As it was before: still listening.
    pub hand_over: HandOver,
    /// What was in the way.
    pub reason: DomainSocketError,
}
