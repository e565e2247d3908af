//! The policy of a domain: the file beside its socket (SM2-ACC-012).

use std::{
    ffi::OsString,
    fs, io,
    os::unix::fs::{MetadataExt, symlink},
    path::{Path, PathBuf},
    process,
};

use nix::unistd::geteuid;

use super::{PolicyFile, error::PolicyFileError, opened::Opened};
use crate::Options;

/// Every user may write.
const WRITABLE: u32 = 0o002;

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(suffix);
    name.into()
}

/// Checks that the Manager of the socket at `socket` could use the policy of its domain. A folder that cannot
/// be searched is not an error here: making the socket in it fails as well, and says what to do.
pub(crate) fn check(socket: &Path, options: &Options) -> Result<(), PolicyFileError> {
    let beside = with_suffix(socket, ".policy");
    match &options.policy_file {
        Some(file) => load(file).map(drop),
        None if is_present(&beside).unwrap_or(false) => load(&beside).map(drop),
        None => Ok(()),
    }
}

/// Reads the policy of the domain whose socket is at `socket`; `None` if the domain has none. A policy that
/// the options name becomes that of the domain. The caller holds the lock of the domain.
//= SM2-ACC-012
pub(crate) fn of_domain(
    socket: &Path,
    options: &Options,
) -> Result<Option<PolicyFile>, PolicyFileError> {
    let path = with_suffix(socket, ".policy");
    if let Some(file) = &options.policy_file {
        let policy = load(file)?;
        link(&path, file).map_err(|source| PolicyFileError::NotLinked { path, source })?;
        return Ok(Some(policy));
    }
    match is_present(&path) {
        Ok(true) => load(&path).map(Some),
        Ok(false) => Ok(None),
        Err(source) => Err(PolicyFileError::Io { path, source }),
    }
}

/// Whether there is a directory entry at `path`. A link that leads nowhere is one.
fn is_present(path: &Path) -> io::Result<bool> {
    match fs::symlink_metadata(path) {
        Ok(_) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(error),
    }
}

fn load(path: &Path) -> Result<PolicyFile, PolicyFileError> {
    let file = Opened::at(path)?;
    let (uid, mode) = (file.metadata.uid(), file.metadata.mode() & 0o7777);
    let is_ours = uid == 0 || uid == geteuid().as_raw();
    if !is_ours || mode & WRITABLE != 0 {
        let path = path.into();
        return Err(PolicyFileError::NotTrusted { path, uid, mode });
    }
    PolicyFile::parse(path, &file.text()?)
}

/// Makes `path` a link to `file`, in one step. A file at `path` that is not a link is left alone.
fn link(path: &Path, file: &Path) -> io::Result<()> {
    let file = fs::canonicalize(file)?;
    if fs::canonicalize(path).is_ok_and(|it| it == file) {
        return Ok(());
    }
    if fs::symlink_metadata(path).is_ok_and(|it| !it.is_symlink()) {
        let text = "it is a file of its own: remove it, or start without --policy";
        return Err(io::Error::new(io::ErrorKind::AlreadyExists, text));
    }
    let new = with_suffix(path, &format!(".{}", process::id()));
    // A process with this number may have been killed here.
    let _ = fs::remove_file(&new);
    symlink(&file, &new)?;
    fs::rename(&new, path)
}
