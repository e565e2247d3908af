//! A domain's socket has one owner at a time, and no file is left behind.

use std::fs::{self, Permissions};
use std::os::unix::fs::{FileTypeExt, MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use nix::libc;
use sm2_io::fault::{Call, Fault, Injector};
use sm2_io::{BindOptions, DomainLock, DomainSocketError, Listener, SeqPacket};
use tempfile::TempDir;

fn place() -> (TempDir, PathBuf) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("sm2/default.sock");
    (directory, path)
}

fn mode(path: &Path) -> u32 {
    fs::symlink_metadata(path).unwrap().mode() & 0o7777
}

fn names_in(directory: &Path) -> Vec<String> {
    let entries = fs::read_dir(directory).unwrap();
    let mut names: Vec<_> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

fn is_served(path: &Path) -> bool {
    SeqPacket::connect(path).is_ok()
}

#[test]
fn an_owner_listens_and_leaves_nothing() {
    let (_guard, path) = place();
    let endpoint = BindOptions::acquire(&path).unwrap();
    let directory = path.parent().unwrap();
    assert_eq!(endpoint.path(), path);
    assert_eq!((mode(directory), mode(&path)), (0o700, 0o600));
    assert_eq!(mode(&directory.join("default.sock.lock")), 0o600);
    assert_eq!(names_in(directory), ["default.sock", "default.sock.lock"]);
    let client = SeqPacket::connect(&path).unwrap();
    let server = endpoint.listener().accept().unwrap().unwrap();
    assert_eq!(
        client.peer_credentials().unwrap().pid,
        server.peer_credentials().unwrap().pid
    );

    endpoint.close();
    assert!(names_in(directory).is_empty());
    drop(BindOptions::acquire(&path).unwrap());
    assert!(names_in(directory).is_empty());
}

/// Closing the file unlocks it as well.
#[test]
fn an_owner_that_cannot_unlock_its_file_leaves_nothing() {
    for errno in [libc::EINTR, libc::ENOLCK] {
        let (_guard, path) = place();
        let faults = Injector::counting();
        let _installed = faults.install();
        let endpoint = BindOptions::acquire(&path).unwrap();
        faults.set([Fault {
            call: Call::FileLock,
            nth: 1,
            times: 1,
            errno,
        }]);
        endpoint.close();
        assert_eq!(faults.hits(), 1);
        assert!(names_in(path.parent().unwrap()).is_empty());
        drop(BindOptions::acquire(&path).unwrap());
    }
}

#[test]
fn the_second_is_told_that_it_is_busy() {
    let (_guard, path) = place();
    let first = BindOptions::acquire(&path).unwrap();
    for _ in 0..2 {
        let Err(DomainSocketError::Busy { path: busy }) = BindOptions::acquire(&path) else {
            panic!("two owners");
        };
        assert_eq!(busy, path);
    }
    assert!(is_served(&path));
    drop(first);
    assert!(!is_served(&path));
    let second = BindOptions::acquire(&path).unwrap();
    assert!(is_served(second.path()));
}

#[test]
fn what_a_dead_owner_left_is_replaced() {
    let (_guard, path) = place();
    let directory = path.parent().unwrap();
    fs::create_dir(directory).unwrap();
    drop(Listener::bind(&path, 1).unwrap());
    drop(Listener::bind(&directory.join("default.sock~"), 1).unwrap());
    fs::write(directory.join("default.sock.lock"), "").unwrap();
    let stale = fs::metadata(&path).unwrap().ino();
    assert!(!is_served(&path));

    let endpoint = BindOptions::acquire(&path).unwrap();
    assert!(is_served(&path));
    assert_ne!(fs::metadata(&path).unwrap().ino(), stale);
    drop(endpoint);
    assert!(names_in(directory).is_empty());
}

#[test]
fn a_file_that_is_not_a_socket_is_left_alone() {
    let (_guard, path) = place();
    let directory = path.parent().unwrap();
    fs::create_dir(directory).unwrap();
    fs::write(&path, "precious").unwrap();
    assert!(matches!(
        BindOptions::acquire(&path),
        Err(DomainSocketError::NotASocket { .. })
    ));
    assert_eq!(fs::read(&path).unwrap(), b"precious");
    assert_eq!(names_in(directory), ["default.sock"]);
}

#[test]
fn only_what_is_ours_is_removed() {
    let (_guard, path) = place();
    let endpoint = BindOptions::acquire(&path).unwrap();
    fs::remove_file(&path).unwrap();
    let _theirs = Listener::bind(&path, 1).unwrap();
    drop(endpoint);
    assert!(is_served(&path));
    assert_eq!(names_in(path.parent().unwrap()), ["default.sock"]);
}

#[test]
fn the_mode_is_the_operators_choice() {
    let (_guard, path) = place();
    let claim = BindOptions {
        mode: 0o666,
        ..BindOptions::default()
    };
    let _endpoint = claim.acquire_at(&path).unwrap();
    // The umask does not apply.
    assert_eq!(mode(&path), 0o666);
    assert!(fs::metadata(&path).unwrap().file_type().is_socket());
}

#[test]
fn places_that_others_control_are_refused() {
    let (_guard, path) = place();
    let directory = path.parent().unwrap();
    fs::create_dir(directory).unwrap();
    let set_mode = |mode| fs::set_permissions(directory, Permissions::from_mode(mode)).unwrap();
    set_mode(0o777);
    let result = BindOptions::acquire(&path);
    assert!(matches!(
        result,
        Err(DomainSocketError::DirectoryWritable { mode: 0o777, .. })
    ));
    assert!(names_in(directory).is_empty());
    for fine in [0o1777, 0o770, 0o755] {
        set_mode(fine);
        drop(BindOptions::acquire(&path).unwrap());
        assert_eq!(
            mode(directory),
            fine,
            "an existing directory is not changed"
        );
    }
    // Only root can change the owner of a directory.
    if std::os::unix::fs::chown(directory, Some(12345), None).is_ok() {
        let result = BindOptions::acquire(&path);
        assert!(matches!(
            result,
            Err(DomainSocketError::DirectoryOwner { uid: 12345, .. })
        ));
    }
}

#[test]
fn only_the_last_directory_is_created() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("missing/sm2/default.sock");
    let Err(DomainSocketError::Io { action, source, .. }) = BindOptions::acquire(&path) else {
        panic!("created the directory above");
    };
    assert_eq!(
        (action, source.kind()),
        ("create directory", std::io::ErrorKind::NotFound)
    );
    let long = directory.path().join("x".repeat(107));
    assert!(matches!(
        BindOptions::acquire(&long),
        Err(DomainSocketError::PathTooLong { .. })
    ));
}

#[test]
fn a_lock_can_be_held_without_a_socket() {
    let (_guard, path) = place();
    let lock = DomainLock::acquire(&path).unwrap();
    assert!(matches!(
        BindOptions::acquire(&path),
        Err(DomainSocketError::Busy { .. })
    ));
    let endpoint = lock.bind(BindOptions::default()).unwrap();
    assert!(is_served(endpoint.path()));
}

/// In this test the lock file is removed and created again all the time.
#[test]
fn never_two_owners() {
    let (_guard, path) = place();
    fs::create_dir(path.parent().unwrap()).unwrap();
    let (owners, owned) = (AtomicU32::new(0), AtomicU32::new(0));
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                for _ in 0..2000 {
                    match DomainLock::acquire(&path) {
                        Ok(lock) => {
                            assert_eq!(owners.fetch_add(1, Ordering::SeqCst), 0, "two owners");
                            owned.fetch_add(1, Ordering::SeqCst);
                            std::thread::yield_now();
                            owners.fetch_sub(1, Ordering::SeqCst);
                            drop(lock);
                        }
                        Err(DomainSocketError::Busy { .. }) => {}
                        Err(error) => panic!("{error}"),
                    }
                }
            });
        }
    });
    assert!(owned.into_inner() > 0);
    assert!(names_in(path.parent().unwrap()).is_empty());
}
