//! The private folder of the demo's socket, which exists until all processes have connected.

use std::{
    env,
    fs::{self, File, Metadata},
    io,
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    time::Duration,
};

use nix::{
    fcntl::{Flock, FlockArg},
    unistd::geteuid,
};
use tempfile::TempDir;

use crate::error::DemoError;

/// The longest parent path: the path of a socket is limited to 107 bytes, and the rest is for names.
const PARENT_MAX_BYTES: usize = 64;

/// The prefix of the folders' names.
const PREFIX: &str = "sm2-demo-";

/// The name of the socket.
pub(crate) const SOCKET: &str = "demo.sock";

/// The file that the Manager of a demo has locked.
const LOCK: &str = "demo.sock.lock";

/// Younger folders are left alone: their Manager may be about to take its lock, and fails if this
/// process holds the lock at that time.
const MIN_AGE: Duration = Duration::from_secs(60);

/// Makes a folder for this demo, which is removed when it is dropped. Also removes the folders of
/// demos that were killed while they started.
///
/// # Errors
///
/// [`DemoError::Folder`].
pub(crate) fn private() -> Result<TempDir, DemoError> {
    let parent = parent(env::temp_dir());
    remove_leftovers(&parent);
    let mut builder = tempfile::Builder::new();
    let folder = builder.prefix(PREFIX).tempdir_in(&parent);
    folder.map_err(|source| DemoError::Folder { parent, source })
}

/// The folder for temporary files, or `/tmp` if its path is too long.
fn parent(temporary: PathBuf) -> PathBuf {
    match temporary.as_os_str().len() <= PARENT_MAX_BYTES {
        true => temporary,
        false => "/tmp".into(),
    }
}

/// Removes the folders of killed demos. Ignores errors: such a folder does no harm.
fn remove_leftovers(parent: &Path) {
    let entries = fs::read_dir(parent).into_iter().flatten().flatten();
    for entry in entries {
        let is_ours = entry
            .file_name()
            .as_encoded_bytes()
            .starts_with(PREFIX.as_bytes());
        let path = entry.path();
        // The metadata of the entry itself: symbolic links are not followed.
        if is_ours
            && entry
                .metadata()
                .is_ok_and(|found| is_leftover(&path, &found))
        {
            let _ = fs::remove_dir_all(&path);
        }
    }
}

/// True if a folder belongs to this user and to a demo that has ended: no process holds its lock.
/// (Process numbers would not identify processes in other containers.)
fn is_leftover(folder: &Path, found: &Metadata) -> bool {
    let age = found.modified().ok().and_then(|at| at.elapsed().ok());
    let is_old = age.is_some_and(|age| age > MIN_AGE);
    if !found.is_dir() || found.uid() != geteuid().as_raw() || !is_old {
        return false;
    }
    match File::open(folder.join(LOCK)) {
        Ok(file) => Flock::lock(file, FlockArg::LockExclusiveNonblock).is_ok(),
        Err(error) => error.kind() == io::ErrorKind::NotFound,
    }
}

#[cfg(test)]
mod tests;
