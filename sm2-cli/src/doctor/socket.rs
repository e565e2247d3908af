//! Checks of the socket's path, of its folder, and of files that dead Managers left there.

use std::{
    env, fs,
    os::unix::fs::{FileTypeExt, MetadataExt},
    path::{Path, PathBuf},
};

use nix::unistd::geteuid;

use super::check::Check;
use crate::args::Domain;

pub(super) fn checks(domain: &Domain, path: &Path) -> Vec<Check> {
    let mut checks = vec![Check::ok(
        "socket path",
        format!(
            "{} ({})",
            path.display(),
            rule(domain, |name| env::var(name).ok())
        ),
    )];
    checks.push(folder(path));
    checks.extend(leftovers(path));
    checks
}

/// The rule of SM2-TRN-001 that chose the path.
pub(super) fn rule(domain: &Domain, variable: impl Fn(&str) -> Option<String>) -> String {
    let set = |name: &str| variable(name).is_some_and(|value| !value.is_empty());
    if domain.socket.is_some() {
        return "from --socket".into();
    }
    let (name, from) = match &domain.domain {
        Some(name) => (name.clone(), "--domain"),
        None if set("SM2_SOCKET") => return "from $SM2_SOCKET".into(),
        None if set("SM2_DOMAIN") => (variable("SM2_DOMAIN").unwrap_or_default(), "$SM2_DOMAIN"),
        None => ("default".into(), "the default"),
    };
    let runtime = variable("XDG_RUNTIME_DIR").filter(|value| value.starts_with('/'));
    let folder = match runtime {
        Some(_) => "$XDG_RUNTIME_DIR",
        None => "/run, since $XDG_RUNTIME_DIR is not set",
    };
    format!("domain {name} by {from}, in {folder}")
}

/// Checks whether another user could replace the Manager's socket.
fn folder(path: &Path) -> Check {
    const CHECK: &str = "folder";
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let shown = folder.display();
    let found = match fs::metadata(folder) {
        Ok(found) if found.is_dir() => found,
        Ok(_) => {
            return Check::bad(
                CHECK,
                format!("{shown} is not a folder"),
                "name another socket",
            );
        }
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            return Check::warn(
                CHECK,
                format!("{shown} does not exist"),
                "the Manager makes it if it may; else create it (mode 0700) or set XDG_RUNTIME_DIR",
            );
        }
        Err(error) => {
            return Check::bad(
                CHECK,
                format!("{shown}: {error}"),
                "have its owner let this user enter it, or name another socket",
            );
        }
    };
    let (mode, owner) = (found.mode() & 0o7777, found.uid());
    let facts = format!("{shown} (mode {mode:04o}, user {owner})");
    if mode & 0o002 != 0 && mode & 0o1000 == 0 {
        return Check::bad(
            CHECK,
            facts,
            format!("anybody can replace the socket: chmod o-w {shown}"),
        );
    }
    if owner != 0 && owner != geteuid().as_raw() {
        return Check::warn(
            CHECK,
            facts,
            "its owner can replace the socket: trust them, or name another socket",
        );
    }
    Check::ok(CHECK, facts)
}

/// Checks for files beside the socket that no living Manager uses.
fn leftovers(path: &Path) -> Vec<Check> {
    const CHECK: &str = "leftovers";
    let mut checks = Vec::new();
    let lock = with_suffix(path, ".lock");
    let fresh = with_suffix(path, "~");
    if fs::symlink_metadata(&fresh).is_ok() {
        checks.push(Check::warn(
            CHECK,
            format!("{} is there", fresh.display()),
            "a Manager died while it started; the next one removes it",
        ));
    }
    let locks = fs::read_to_string("/proc/locks").unwrap_or_default();
    match fs::metadata(&lock) {
        Ok(found) if !is_locked(&locks, found.ino()) => checks.push(Check::warn(
            CHECK,
            format!("{} is there and nobody holds it", lock.display()),
            "a Manager was killed; the next one takes the lock",
        )),
        _ => {}
    }
    match fs::symlink_metadata(path) {
        Ok(found) if !found.file_type().is_socket() => checks.push(Check::bad(
            CHECK,
            format!("{} is not a socket", path.display()),
            "remove it, or name another socket",
        )),
        _ => {}
    }
    if checks.is_empty() {
        checks.push(Check::ok(CHECK, "none"));
    }
    checks
}

/// Whether `/proc/locks` has a lock on a file with this inode: `1: FLOCK ADVISORY WRITE 77 fe:00:123 0 EOF`.
pub(super) fn is_locked(locks: &str, inode: u64) -> bool {
    let suffix = format!(":{inode}");
    locks
        .lines()
        .filter(|line| !line.contains("->"))
        .any(|line| line.split_whitespace().any(|word| word.ends_with(&suffix)))
}

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    name.into()
}
