//! The socket in the file system, and which process removes it.

use std::fs;
use std::path::{Path, PathBuf};

use super::files::{Identity, names};
use super::lock::DomainLock;

/// A domain's socket in the file system. Dropping it removes it, if that is ours to do.
#[derive(Debug)]
pub(super) struct SocketFile {
    path: PathBuf,
    identity: Identity,
    whose: Whose,
    /// Nobody here holds the lock now.
    unlocked: bool,
}

/// Who removes a socket's file in the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Whose {
    /// This value.
    Ours,
    /// Whoever made the socket, and handed it to us.
    SomebodyElses,
}

impl SocketFile {
    /// The one at `path`, whose lock is held for as long as this lives, or until
    /// [`unlocked`](Self::unlocked).
    pub(super) fn new(path: &Path, identity: Identity, whose: Whose) -> Self {
        Self {
            path: path.to_owned(),
            identity,
            whose,
            unlocked: false,
        }
    }

    /// From now on the lock may be somebody else's.
    pub(super) fn unlocked(self) -> Self {
        self.with(true)
    }

    /// The lock is held again.
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

    /// Whether the path still names it.
    pub(super) fn is_there(&self) -> bool {
        names(&self.path, self.identity)
    }
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        // If somebody has put something else there, it is theirs.
        if !self.is_there() {
            return;
        }
        let lock = self.unlocked.then(|| DomainLock::acquire(&self.path));
        // Without the lock, somebody is about to replace it. With it, look again. The lock's
        // own file goes with the lock, whosever the socket is.
        let alone = !matches!(lock, Some(Err(_)));
        if alone && self.whose == Whose::Ours && self.is_there() {
            let _ = fs::remove_file(&self.path);
        }
    }
}
