//! The socket in the file system, and which process removes it.

use std::path::{Path, PathBuf};

use super::files::{Identity, names};
use super::lock::DomainLock;
use crate::syscall::files::remove;

/// A domain's socket in the file system. Dropping it removes the file if this process made it.
#[derive(Debug)]
pub(super) struct SocketFile {
    path: PathBuf,
    identity: Identity,
    whose: Whose,
    /// Whether this process has released the lock.
    unlocked: bool,
}

/// Which process removes a socket's file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Whose {
    /// This process made the socket, and removes it.
    Ours,
    /// Another process made the socket and passed it on: it removes it.
    SomebodyElses,
}

impl SocketFile {
    /// The socket at `path`, whose lock is held as long as the result exists, or until
    /// [`unlocked`](Self::unlocked).
    pub(super) fn new(path: &Path, identity: Identity, whose: Whose) -> Self {
        Self {
            path: path.to_owned(),
            identity,
            whose,
            unlocked: false,
        }
    }

    /// From now on another process may hold the lock.
    pub(super) fn unlocked(self) -> Self {
        self.with(true)
    }

    /// From now on this process holds the lock again.
    pub(super) fn locked(self) -> Self {
        self.with(false)
    }

    fn with(mut self, unlocked: bool) -> Self {
        self.unlocked = unlocked;
        self
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Whether the path still names this socket.
    pub(super) fn is_there(&self) -> bool {
        names(&self.path, self.identity)
    }
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        // Another file at the path belongs to another process.
        if !self.is_there() {
            return;
        }
        let lock = self.unlocked.then(|| DomainLock::acquire(&self.path));
        // If another process holds the lock, it is about to replace the socket. With the lock, check the
        // path again. Dropping the lock removes the lock's own file in any case.
        let alone = !matches!(lock, Some(Err(_)));
        if alone && self.whose == Whose::Ours && self.is_there() {
            let _ = remove(&self.path);
        }
    }
}
