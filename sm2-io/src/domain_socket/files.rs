//! The files beside a domain's socket, and its directory.

use std::ffi::OsString;
use std::fs::Metadata;
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::error::DomainSocketError;
use crate::syscall::files;

/// The identity of a file, independent of its name.
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

/// Whether `path` names that file.
pub(super) fn names(path: &Path, identity: Identity) -> bool {
    files::symlink_metadata(path).is_ok_and(|found| Identity::of(&found) == identity)
}

pub(super) fn directory_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Creates the directory, or checks that no other user can replace files in it.
pub(super) fn prepare_directory(path: &Path) -> Result<(), DomainSocketError> {
    match files::create_directory(path, 0o700) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => {
            return Err(failed("create directory", path)(error));
        }
        _ => {}
    }
    let found = files::metadata(path).map_err(failed("look at directory", path))?;
    let (mode, uid) = (found.mode() & 0o7777, found.uid());
    let path = path.to_owned();
    let sticky = mode & 0o1000 != 0;
    if mode & 0o002 != 0 && !sticky {
        return Err(DomainSocketError::DirectoryWritable { path, mode });
    }
    if uid != 0 && uid != files::user() {
        return Err(DomainSocketError::DirectoryOwner { path, uid });
    }
    Ok(())
}

pub(super) fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(suffix);
    name.into()
}

pub(super) fn failed(
    action: &'static str,
    path: &Path,
) -> impl FnOnce(io::Error) -> DomainSocketError {
    move |source| DomainSocketError::Io {
        action,
        path: path.to_owned(),
        source,
    }
}
