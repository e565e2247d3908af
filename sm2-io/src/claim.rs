//! Owning a domain's socket: at most one process at a time.
//!
//! A file beside the socket, `<path>.lock`, is locked (`flock(2)`) for as long as the
//! owner lives; the kernel lets go of it when the owner dies, however it dies. Whoever
//! holds the lock may replace what a dead owner left behind. Both files are removed
//! by an owner that ends in an orderly way.

use std::ffi::OsString;
use std::fs::{self, DirBuilder, File, Metadata, OpenOptions, Permissions};
use std::io;
use std::os::unix::fs::{DirBuilderExt, FileTypeExt, MetadataExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};
use nix::libc;

use crate::endpoint::{EndpointError, check_path};
use crate::socket::Listener;

/// How to claim a domain's socket.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Claim {
    /// Permission bits of the socket: who may connect needs to write. The
    /// umask does not count. 0600 by default.
    pub mode: u32,
    /// How many connections may wait to be accepted. 128 by default.
    pub backlog: u32,
}

impl Default for Claim {
    fn default() -> Self {
        Self {
            mode: 0o600,
            backlog: 128,
        }
    }
}

impl Claim {
    /// Claims `path` with the defaults. See [`acquire_at`](Self::acquire_at).
    ///
    /// # Errors
    ///
    /// As [`acquire_at`](Self::acquire_at).
    pub fn acquire(path: &Path) -> Result<Endpoint, EndpointError> {
        Self::default().acquire_at(path)
    }

    /// Becomes the owner of `path`, and listens there.
    ///
    /// Creates the directory (0700) if it does not exist, but not the one above it.
    /// Replaces a socket that a dead owner left, without a moment in which there is none.
    ///
    /// # Errors
    ///
    /// [`EndpointError::Busy`] if somebody else owns it; the other kinds say what is
    /// wrong with the place.
    pub fn acquire_at(self, path: &Path) -> Result<Endpoint, EndpointError> {
        DomainLock::acquire(path)?.bind(self)
    }
}

/// The right to bind a domain's socket. Held by at most one process.
#[derive(Debug)]
pub struct DomainLock {
    socket_path: PathBuf,
    lock_path: PathBuf,
    /// Given up when this is closed.
    _lock: Flock<File>,
}

impl DomainLock {
    /// Takes the lock for the socket at `path`; does not wait for it.
    ///
    /// # Errors
    ///
    /// [`EndpointError::Busy`] if it is taken; the other kinds say what is wrong with the
    /// place.
    pub fn acquire(path: &Path) -> Result<Self, EndpointError> {
        check_path(path)?;
        prepare_directory(directory_of(path))?;
        let lock_path = with_suffix(path, ".lock");
        loop {
            let file = OpenOptions::new()
                .read(true)
                .write(true)
                .create(true)
                .truncate(false)
                .mode(0o600)
                .custom_flags(libc::O_NOFOLLOW | libc::O_CLOEXEC)
                .open(&lock_path)
                .map_err(failed("open", &lock_path))?;
            let lock = match Flock::lock(file, FlockArg::LockExclusiveNonblock) {
                Ok(lock) => lock,
                Err((_, Errno::EWOULDBLOCK)) => {
                    let path = path.to_owned();
                    return Err(EndpointError::Busy { path });
                }
                Err((_, Errno::EINTR)) => continue,
                Err((_, errno)) => return Err(failed("lock", &lock_path)(errno.into())),
            };
            // Between our `open` and our lock its holder may have removed the file. Then this
            // is a lock on nothing, and another process may hold the real one.
            let ours = lock.metadata().map_err(failed("look at", &lock_path))?;
            if names(&lock_path, Identity::of(&ours)) {
                return Ok(Self {
                    socket_path: path.to_owned(),
                    lock_path,
                    _lock: lock,
                });
            }
        }
    }

    /// Binds the socket and listens.
    ///
    /// # Errors
    ///
    /// [`EndpointError::NotASocket`], [`EndpointError::Io`].
    pub fn bind(self, claim: Claim) -> Result<Endpoint, EndpointError> {
        let path = &self.socket_path;
        match fs::symlink_metadata(path) {
            Ok(found) if !found.file_type().is_socket() => {
                let path = path.clone();
                return Err(EndpointError::NotASocket { path });
            }
            _ => {}
        }
        // Bound under another name, and renamed when it is ready: nobody meets a socket that
        // does not listen yet, or whose permissions are not set yet.
        let fresh = with_suffix(path, "~");
        match fs::remove_file(&fresh) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => {
                return Err(failed("remove", &fresh)(error));
            }
            _ => {}
        }
        let listener =
            Listener::bind(&fresh, claim.backlog).map_err(failed("bind a socket at", &fresh))?;
        let publish = || {
            fs::set_permissions(&fresh, Permissions::from_mode(claim.mode & 0o777))?;
            let identity = Identity::of(&fs::symlink_metadata(&fresh)?);
            fs::rename(&fresh, path)?;
            Ok(identity)
        };
        match publish() {
            Ok(identity) => Ok(Endpoint {
                listener,
                identity,
                lock: self,
            }),
            Err(error) => {
                let _ = fs::remove_file(&fresh);
                Err(failed("publish the socket at", path)(error))
            }
        }
    }

    /// The path of the socket that this lock is for.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.socket_path
    }
}

impl Drop for DomainLock {
    fn drop(&mut self) {
        // Still locked: whoever opened this file before will find, once it gets the lock,
        // that the name is gone, and try again.
        let _ = fs::remove_file(&self.lock_path);
    }
}

/// A domain's socket, owned and listening. Dropping it removes its files.
#[derive(Debug)]
pub struct Endpoint {
    listener: Listener,
    identity: Identity,
    /// Last, so that it is given up when all else is gone.
    lock: DomainLock,
}

impl Endpoint {
    /// Where connections arrive.
    #[must_use]
    pub const fn listener(&self) -> &Listener {
        &self.listener
    }

    /// Where the socket is.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.lock.path()
    }

    /// Stops listening and removes the files: the same as dropping.
    pub fn close(self) {}
}

impl Drop for Endpoint {
    fn drop(&mut self) {
        // If somebody has put something else there, it is theirs.
        if names(self.path(), self.identity) {
            let _ = fs::remove_file(self.path());
        }
    }
}

/// Which file it is, whatever its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Identity {
    device: u64,
    inode: u64,
}

impl Identity {
    fn of(metadata: &Metadata) -> Self {
        Self {
            device: metadata.dev(),
            inode: metadata.ino(),
        }
    }
}

/// Whether `path` is a name of that file.
fn names(path: &Path, identity: Identity) -> bool {
    fs::symlink_metadata(path).is_ok_and(|found| Identity::of(&found) == identity)
}

fn directory_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Creates it, or checks that nobody can replace what we put there.
fn prepare_directory(path: &Path) -> Result<(), EndpointError> {
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

fn with_suffix(path: &Path, suffix: &str) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(suffix);
    name.into()
}

fn failed(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> EndpointError {
    move |source| EndpointError::Io {
        action,
        path: path.to_owned(),
        source,
    }
}
