//! Handing a socket over to a successor, and adopting a socket of another process.

use std::fs;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use nix::sys::socket::{self, AddressFamily, SockFlag, SockType, UnixAddr};
use sm2_io::{
    BindOptions, DomainLock, DomainSocket, DomainSocketError, Listener, SeqPacket, UnlockedSocket,
};
use tempfile::TempDir;

fn place() -> (TempDir, PathBuf) {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("sm2/default.sock");
    (directory, path)
}

fn names_in(directory: &Path) -> Vec<String> {
    let entries = fs::read_dir(directory).unwrap();
    let mut names: Vec<_> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

/// Whether a new connection arrives at this listener.
fn arrives_at(listener: &Listener, path: &Path) -> bool {
    let _client = SeqPacket::connect(path).unwrap();
    listener.accept().unwrap().is_some()
}

fn busy<T>(result: Result<T, DomainSocketError>) -> bool {
    matches!(result, Err(DomainSocketError::Busy { .. }))
}

/// Checks that the socket is not reclaimed. Returns the reason.
fn refused(old: UnlockedSocket) -> (UnlockedSocket, DomainSocketError) {
    let not = *old.reclaim().unwrap_err();
    (not.socket, not.reason)
}

//= SM2-RES-009 test
//= SM2-TRN-007 test
#[test]
fn a_successor_replaces_the_socket_in_one_step() {
    let (_guard, path) = place();
    let old = BindOptions::acquire(&path).unwrap();
    assert!(busy(DomainLock::acquire(&path)));
    let old = old.hand_over();
    assert_eq!(old.path(), path);
    assert!(!old.is_replaced() && arrives_at(old.listener(), &path));

    let lock = DomainLock::acquire(&path).unwrap();
    assert!(busy(DomainLock::acquire(&path)), "one successor");
    assert!(!old.is_replaced() && arrives_at(old.listener(), &path));
    let waiting = SeqPacket::connect(&path).unwrap();
    let new = lock.bind(BindOptions::default()).unwrap();
    assert!(old.is_replaced() && arrives_at(new.listener(), &path));
    assert!(old.listener().accept().unwrap().is_some(), "who waited");
    drop((waiting, old));
    assert!(arrives_at(new.listener(), &path));
    assert!(busy(DomainLock::acquire(&path)));
    drop(new);
    assert!(names_in(path.parent().unwrap()).is_empty());
}

//= SM2-RES-009 test
#[test]
fn what_nobody_took_is_taken_back() {
    let (_guard, path) = place();
    let mut endpoint = BindOptions::acquire(&path).unwrap();
    for _ in 0..3 {
        endpoint = endpoint.hand_over().reclaim().unwrap();
        assert!(busy(DomainLock::acquire(&path)));
        assert!(arrives_at(endpoint.listener(), &path));
    }
    // A process that only takes the lock prevents reclaiming until it releases the lock.
    let old = endpoint.hand_over();
    let lock = DomainLock::acquire(&path).unwrap();
    let (old, reason) = refused(old);
    assert!(busy::<()>(Err(reason)));
    drop(lock);
    let endpoint = old.reclaim().unwrap();
    assert!(busy(DomainLock::acquire(&path)));
    drop(endpoint);
    assert!(names_in(path.parent().unwrap()).is_empty());
}

#[test]
fn what_was_replaced_is_not_taken_back() {
    let (_guard, path) = place();
    let old = BindOptions::acquire(&path).unwrap().hand_over();
    let new = BindOptions::acquire(&path).unwrap();
    let (old, reason) = refused(old);
    assert!(busy::<()>(Err(reason)));
    // The successor has ended; another process could take the path now.
    drop(new);
    assert!(old.is_replaced());
    let (old, reason) = refused(old);
    assert!(matches!(reason, DomainSocketError::Replaced { path: of } if of == path));
    assert!(names_in(path.parent().unwrap()).is_empty());
    let new = BindOptions::acquire(&path).unwrap();
    drop(old);
    assert!(arrives_at(new.listener(), &path));
}

#[test]
fn an_end_in_the_middle_leaves_nothing_that_is_ours() {
    let (_guard, path) = place();
    let directory = path.parent().unwrap();
    // No successor has come.
    drop(BindOptions::acquire(&path).unwrap().hand_over());
    assert!(names_in(directory).is_empty());
    // A successor that is about to bind: the path names a socket at every moment.
    let old = BindOptions::acquire(&path).unwrap().hand_over();
    let lock = DomainLock::acquire(&path).unwrap();
    drop(old);
    assert_eq!(names_in(directory), ["default.sock", "default.sock.lock"]);
    let new = lock.bind(BindOptions::default()).unwrap();
    assert!(arrives_at(new.listener(), &path));
    drop(new);
    // The directory is gone, and does not come back.
    let old = BindOptions::acquire(&path).unwrap().hand_over();
    fs::remove_dir_all(directory).unwrap();
    drop(old);
    assert!(!directory.exists());
}

/// Returns a socket as systemd passes it: bound and listening, with a file that this process must not remove.
fn activated(path: &Path) -> OwnedFd {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    Listener::bind(path, 5).unwrap().into()
}

//= SM2-TRN-007 test
#[test]
fn a_socket_from_outside_is_used_and_left() {
    let (_guard, path) = place();
    let socket = activated(&path);
    let kept = socket.try_clone().unwrap();
    let early = SeqPacket::connect(&path).unwrap();
    let endpoint = BindOptions::default().adopt(socket).unwrap();
    assert_eq!(endpoint.path(), path);
    assert!(busy(BindOptions::acquire(&path)));
    let accepted = endpoint.listener().accept().unwrap();
    assert!(accepted.is_some(), "came before us");
    drop((early, accepted));
    assert!(arrives_at(endpoint.listener(), &path));
    assert!(busy(
        BindOptions::default().adopt(kept.try_clone().unwrap())
    ));

    // The same after a hand-over, with and without a successor.
    let endpoint = endpoint.hand_over().reclaim().unwrap();
    drop(endpoint);
    assert_eq!(names_in(path.parent().unwrap()), ["default.sock"]);
    let again = BindOptions::default()
        .adopt(kept.try_clone().unwrap())
        .unwrap();
    drop(again.hand_over());
    assert_eq!(names_in(path.parent().unwrap()), ["default.sock"]);
    assert!(arrives_at(&Listener::from_fd(kept).unwrap(), &path));
}

#[test]
fn descriptors_that_are_no_socket_of_a_domain() {
    let adopt = |fd: OwnedFd| BindOptions::default().adopt(fd).unwrap_err();
    let (_guard, path) = place();
    let directory = path.parent().unwrap();
    let listener = activated(&path);
    let connected: OwnedFd = SeqPacket::connect(&path).unwrap().into();
    let (pair, _other) = SeqPacket::pair().unwrap();
    let stream = std::os::unix::net::UnixListener::bind(directory.join("stream")).unwrap();
    let not_a_socket = tempfile::tempfile().unwrap();
    for fd in [connected, pair.into(), stream.into(), not_a_socket.into()] {
        let error = adopt(fd);
        assert!(
            matches!(error, DomainSocketError::NotAListener { .. }),
            "{error}"
        );
    }

    let flags = SockFlag::SOCK_CLOEXEC;
    let unix = || socket::socket(AddressFamily::Unix, SockType::SeqPacket, flags, None).unwrap();
    let backlog = || socket::Backlog::new(1).unwrap();
    let without_path = unix();
    let number = std::os::fd::AsRawFd::as_raw_fd(&without_path);
    let name = format!("sm2-io-test-{}", std::process::id());
    socket::bind(number, &UnixAddr::new_abstract(name.as_bytes()).unwrap()).unwrap();
    socket::listen(&without_path, backlog()).unwrap();
    assert!(matches!(adopt(without_path), DomainSocketError::NoPath));

    fs::remove_file(&path).unwrap();
    let error = adopt(listener.try_clone().unwrap());
    assert!(matches!(error, DomainSocketError::Io { .. }), "{error}");
    fs::write(&path, "precious").unwrap();
    assert!(matches!(
        adopt(listener),
        DomainSocketError::NotASocket { .. }
    ));
    assert_eq!(names_in(directory), ["default.sock", "stream"]);
}

/// Owners that start and end in every possible way, as fast as possible.
//= SM2-TRN-007 test
//= SM2-RES-009 test
#[test]
fn never_two_owners() {
    let (_guard, path) = place();
    fs::create_dir(path.parent().unwrap()).unwrap();
    let owners = Owners::default();
    std::thread::scope(|scope| {
        for thread in 0..4 {
            let (owners, path) = (&owners, &path);
            scope.spawn(move || {
                for round in 0..1_500 {
                    match BindOptions::acquire(path) {
                        Ok(endpoint) => owners.own(endpoint, (thread + round) % 4),
                        Err(error) => assert!(busy::<()>(Err(error))),
                    }
                }
            });
        }
    });
    let (owned, reclaimed) = (owners.owned.into_inner(), owners.reclaimed.into_inner());
    println!("{owned} owners, {reclaimed} came back");
    assert!(owned > reclaimed && reclaimed > 0);
    assert!(names_in(path.parent().unwrap()).is_empty());
}

#[derive(Default)]
struct Owners {
    now: AtomicU32,
    owned: AtomicU32,
    reclaimed: AtomicU32,
}

impl Owners {
    fn enter(&self) {
        assert_eq!(self.now.fetch_add(1, Ordering::SeqCst), 0, "two owners");
        self.owned.fetch_add(1, Ordering::Relaxed);
        std::thread::yield_now();
    }

    fn own(&self, endpoint: DomainSocket, way: u32) {
        self.enter();
        self.now.fetch_sub(1, Ordering::SeqCst);
        if way == 0 {
            return endpoint.close();
        }
        let mut old = endpoint.hand_over();
        std::thread::yield_now();
        for _ in 1..way {
            match old.reclaim() {
                Ok(endpoint) => {
                    self.enter();
                    self.reclaimed.fetch_add(1, Ordering::Relaxed);
                    // No other process may have replaced the reclaimed socket.
                    assert!(endpoint.path().exists());
                    self.now.fetch_sub(1, Ordering::SeqCst);
                    old = endpoint.hand_over();
                }
                Err(not) => old = not.socket,
            }
        }
    }
}
