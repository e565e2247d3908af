//! The files of a claim: which one is whose.

use std::ffi::OsString;
use std::fs::{self, DirBuilder, Metadata};
use std::io;
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};

use super::DomainLock;
use crate::endpoint::EndpointError;

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

/// Which file it is, whatever its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Identity {
    device: u64,
    inode: u64,
}

impl Identity {
    pub(super) fn of(metadata: &Metadata) -> Self {
        Self {
            device: metadata.dev(),
            inode: metadata.ino(),
        }
    }
}

/// Whether `path` is a name of that file.
pub(super) fn names(path: &Path, identity: Identity) -> bool {
    fs::symlink_metadata(path).is_ok_and(|found| Identity::of(&found) == identity)
}

pub(super) fn directory_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Creates it, or checks that nobody can replace what we put there.
pub(super) fn prepare_directory(path: &Path) -> Result<(), EndpointError> {
    match DirBuilder::new().mode(0o700).create(path) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => {
            return Err(failed("create directory", path)(error));
        }
        _ => {}
    }
    let found = fs::metadata(path).map_err(failed("look at directory", path))?;
    let (mode, uid) = (found.mode() & 0o7777, found.uid());
    let path = path.to_owned();
    let sticky = mode & 0o1000 != 0;
    if mode & 0o002 != 0 && !sticky {
        return Err(EndpointError::DirectoryWritable { path, mode });
    }
    if uid != 0 && uid != nix::unistd::geteuid().as_raw() {
        return Err(EndpointError::DirectoryOwner { path, uid });
    }
    Ok(())
}

pub(super) fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(suffix);
    name.into()
}

pub(super) fn failed(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> EndpointError {
    move |source| EndpointError::Io {
        action,
        path: path.to_owned(),
        source,
    }
}
