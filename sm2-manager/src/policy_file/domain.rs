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

#[cfg(test)]
mod tests {
    use std::os::unix::fs::chown;

    use super::*;

    #[test]
    fn a_link_that_leads_nowhere_is_a_policy_and_a_missing_folder_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name| folder.path().join(name);
        fs::write(path("file"), "").unwrap();
        symlink(path("nothing"), path("link")).unwrap();
        assert!(is_present(&path("file")).unwrap());
        assert!(is_present(&path("link")).unwrap());
        assert!(!is_present(&path("nothing")).unwrap());
        assert!(is_present(&path("file/policy")).is_err(), "nobody can tell");
    }

    //= SM2-ACC-012 test
    #[test]
    fn the_file_of_another_user_is_not_trusted() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("policy");
        fs::write(&path, "default = \"deny\"").unwrap();
        load(&path).expect("a file of this user");
        if !geteuid().is_root() {
            return sm2_test_support::skip("only root can give a file to another user");
        }
        chown(&path, Some(65_534), None).unwrap();
        let refused = load(&path);
        assert!(
            matches!(
                refused,
                Err(PolicyFileError::NotTrusted { uid: 65_534, .. })
            ),
            "{refused:?}"
        );
    }

    //= SM2-ACC-012 test
    #[test]
    fn the_last_policy_that_was_named_is_that_of_the_domain() {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("domain.sock");
        let link = folder.path().join("domain.sock.policy");
        let named = |file: &Path| {
            let options = Options {
                policy_file: Some(file.to_owned()),
                ..Options::default()
            };
            of_domain(&socket, &options).map(drop)
        };
        for name in ["one", "other", "other", "one"] {
            let file = folder.path().join(name);
            fs::write(&file, "default = \"deny\"").unwrap();
            named(&file).unwrap();
            assert_eq!(
                fs::canonicalize(&link).unwrap(),
                fs::canonicalize(&file).unwrap()
            );
        }
        named(&link).expect("it is the policy already");
        fs::remove_file(&link).unwrap();
        fs::write(&link, "default = \"deny\"").unwrap();
        named(&link).expect("a file of its own is the policy already");
        let refused = named(&folder.path().join("one"));
        assert!(
            matches!(refused, Err(PolicyFileError::NotLinked { .. })),
            "{refused:?}"
        );
        assert!(!fs::symlink_metadata(&link).unwrap().is_symlink());
    }
}
