//! Where the demo's socket is, for as long as its processes connect.

use std::{
    env,
    fs::{self, File, Metadata},
    io,
    os::unix::fs::MetadataExt,
    path::Path,
    time::Duration,
};

use nix::{
    fcntl::{Flock, FlockArg},
    unistd::geteuid,
};
use tempfile::TempDir;

use crate::error::DemoError;

/// The path of a socket is short, and this is what is left of it.
const PARENT_MAX_BYTES: usize = 64;

/// How the names of the folders begin.
const PREFIX: &str = "sm2-demo-";

/// The socket in it.
pub(crate) const SOCKET: &str = "demo.sock";

/// The file that the Manager of a demo has locked.
const LOCK: &str = "demo.sock.lock";

/// A folder that is younger may be one whose Manager is about to take its lock: to try that lock would
/// already be in its way.
const MIN_AGE: Duration = Duration::from_secs(60);

/// A folder of the demo's own, which goes with it. Those of demos that were killed while they
/// started are removed.
///
/// # Errors
///
/// [`DemoError::Folder`].
pub(crate) fn private() -> Result<TempDir, DemoError> {
    let parent = env::temp_dir();
    let fits = parent.as_os_str().len() <= PARENT_MAX_BYTES;
    let parent = if fits { &parent } else { Path::new("/tmp") };
    remove_leftovers(parent);
    let mut builder = tempfile::Builder::new();
    let folder = builder.prefix(PREFIX).tempdir_in(parent);
    folder.map_err(|source| DemoError::Folder {
        parent: parent.to_owned(),
        source,
    })
}

/// What cannot be looked at or removed stays: it is in nobody's way.
fn remove_leftovers(parent: &Path) {
    let entries = fs::read_dir(parent).into_iter().flatten().flatten();
    for entry in entries {
        let is_ours = entry
            .file_name()
            .as_encoded_bytes()
            .starts_with(PREFIX.as_bytes());
        let path = entry.path();
        // Of the entry itself: a link elsewhere is not followed.
        if is_ours
            && entry
                .metadata()
                .is_ok_and(|found| is_leftover(&path, &found))
        {
            let _ = fs::remove_dir_all(&path);
        }
    }
}

/// Whether a folder is of this user, and of a demo that is dead: nobody holds its lock. (A process'
/// number would say nothing about one in another container.)
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
