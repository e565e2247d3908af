//! The lock that makes one process the owner of a domain's socket.

use std::fs::File;
use std::io;
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};

use super::error::DomainSocketError;
use super::files::{Identity, directory_of, failed, names, prepare_directory, with_suffix};
use super::path::check_path;
use crate::syscall::files;
use crate::syscall::fork::Unforked;

/// The right to bind a domain's socket. At most one process holds it, and it ends with this process, even if children
/// that it made by `fork(2)` live on.
#[derive(Debug)]
pub struct DomainLock {
    socket_path: PathBuf,
    lock_path: PathBuf,
    /// `None` while the value is dropped without removing the file.
    lock: Option<(Unforked, File)>,
}

impl DomainLock {
    /// Takes the lock for the socket at `path` without waiting.
    ///
    /// # Errors
    ///
    /// [`DomainSocketError::Busy`] if it is held; the other kinds say what is wrong with the
    /// path.
    pub fn acquire(path: &Path) -> Result<Self, DomainSocketError> {
        check_path(path)?;
        prepare_directory(directory_of(path))?;
        let lock_path = with_suffix(path, ".lock");
        loop {
            let file = files::open_lock(&lock_path).map_err(failed("open", &lock_path))?;
            files::lock_file(&file).map_err(|error| match error.kind() {
                io::ErrorKind::WouldBlock => DomainSocketError::Busy {
                    path: path.to_owned(),
                },
                _ => failed("lock", &lock_path)(error),
            })?;
            // The last holder may have removed the file between `open` and `lock`. Then this lock is on
            // an unlinked file, and another process may hold the lock on the current one.
            let ours = files::metadata_of(&file).map_err(failed("look at", &lock_path))?;
            if names(&lock_path, Identity::of(&ours)) {
                return Ok(Self {
                    socket_path: path.to_owned(),
                    lock_path,
                    lock: Some((Unforked::new(file.as_fd()), file)),
                });
            }
        }
    }

    /// The path of the socket.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.socket_path
    }

    /// Releases the lock, and leaves its file for the next holder.
    pub(super) fn leave(mut self) {
        if let Some((_, lock)) = &self.lock.take() {
            unlock(lock);
        }
    }
}

impl Drop for DomainLock {
    fn drop(&mut self) {
        if let Some((_, lock)) = &self.lock {
            // Still locked: a process that has opened this file will find, once it gets the lock, that
            // the name is gone, and try again.
            let _ = files::remove(&self.lock_path);
            unlock(lock);
        }
    }
}

/// Unlocks the file before it is closed: a child process that is about to call `exec` has a copy of the descriptor. An
/// error is harmless, because the kernel unlocks a file whose last descriptor is closed.
fn unlock(file: &File) {
    let _ = files::unlock(file);
}
