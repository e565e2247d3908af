//! Owning a domain's socket: at most one process at a time.
//!
//! A file beside the socket, `<path>.lock`, is locked (`flock(2)`) for as long as the
//! owner lives; the kernel lets go of it when the owner dies, however it dies. Whoever
//! holds the lock may replace what a dead owner left behind. Both files are removed
//! by an owner that ends in an orderly way.
//!
//! Nobody removes or replaces a file here without holding the lock, and a lock counts
//! only while `<path>.lock` names the file that is locked. So it does not matter who
//! removed that file, or left it, or when: there is never more than one owner.

mod files;
mod hand_over;

pub use hand_over::{HandOver, NotReclaimed};

use std::fs::{self, File, OpenOptions, Permissions};
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{FileTypeExt, OpenOptionsExt, PermissionsExt};
use std::path::{Path, PathBuf};

use nix::errno::Errno;
use nix::fcntl::{Flock, FlockArg};
use nix::libc;

use self::files::{
    Identity, SocketFile, Whose, directory_of, failed, names, prepare_directory, with_suffix,
};
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

    /// Becomes the owner of the path to which a listening socket is bound, and listens
    /// there with it: socket activation.
    ///
    /// Whoever made the socket owns its file: neither its mode is changed, nor is it removed
    /// in the end. From now on, peers that connect see this process as the one that listens
    /// ([`SeqPacket::peer_credentials`](crate::SeqPacket::peer_credentials)).
    ///
    /// # Errors
    ///
    /// [`EndpointError::NotAListener`]; [`EndpointError::NoPath`] if it is bound to no path,
    /// or to one that depends on a current directory; and as
    /// [`acquire_at`](Self::acquire_at), among them [`EndpointError::Busy`]. The socket is
    /// closed then.
    //= SM2-TRN-008
    pub fn adopt(self, socket: OwnedFd) -> Result<Endpoint, EndpointError> {
        let listener =
            Listener::from_fd(socket).map_err(|source| EndpointError::NotAListener { source })?;
        let path = (listener.path())
            .filter(|path| path.is_absolute())
            .ok_or(EndpointError::NoPath)?;
        let lock = DomainLock::acquire(&path)?;
        let found = fs::symlink_metadata(&path).map_err(failed("look at", &path))?;
        if !found.file_type().is_socket() {
            return Err(EndpointError::NotASocket { path });
        }
        (listener.listen(self.backlog)).map_err(failed("listen at", &path))?;
        Ok(Endpoint {
            file: SocketFile::new(&path, Identity::of(&found), Whose::SomebodyElses),
            listener,
            lock,
        })
    }
}

/// The right to bind a domain's socket. Held by at most one process.
#[derive(Debug)]
pub struct DomainLock {
    socket_path: PathBuf,
    lock_path: PathBuf,
    /// `None` while this is dropped without removing the file.
    lock: Option<Flock<File>>,
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
                    lock: Some(lock),
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
                file: SocketFile::new(path, identity, Whose::Ours),
                listener,
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

    /// Gives the lock up, and leaves its file for whoever takes it next.
    fn leave(mut self) {
        // Unlocks, not only closes: a child that is about to start a program has a copy.
        drop(self.lock.take());
    }
}

impl Drop for DomainLock {
    fn drop(&mut self) {
        if self.lock.is_some() {
            // Still locked: whoever opened this file before will find, once it gets the lock,
            // that the name is gone, and try again.
            let _ = fs::remove_file(&self.lock_path);
        }
    }
}

/// A domain's socket, owned and listening. Dropping it removes its files.
#[derive(Debug)]
pub struct Endpoint {
    file: SocketFile,
    listener: Listener,
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

    /// Gives up the lock, so that a successor can take it and replace the socket; until
    /// it does, the socket stays where it is and this process goes on listening.
    //= SM2-RES-010
    #[must_use = "dropping it ends listening"]
    pub fn hand_over(self) -> HandOver {
        let Self {
            file,
            listener,
            lock,
        } = self;
        let hand_over = HandOver::new(file, listener);
        lock.leave();
        hand_over
    }

    /// Stops listening and removes the files: the same as dropping.
    pub fn close(self) {}
}
