//! What can be wrong with a domain's socket.

use std::io;
use std::path::PathBuf;

use super::limits::{MAX_DOMAIN_BYTES, MAX_PATH_BYTES};

/// Why a domain's socket cannot be named or claimed. Each says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DomainSocketError {
    /// The domain's name breaks the grammar.
    #[error(
        "domain name {name:?}: use 1 to {MAX_DOMAIN_BYTES} letters, digits, '_' or '-' (from --domain or SM2_DOMAIN)"
    )]
    DomainName {
        /// The name as it was given.
        name: String,
    },
    /// The path does not fit a socket address.
    #[error(
        "socket path {path:?} has {len_bytes} bytes, {MAX_PATH_BYTES} are possible: set SM2_SOCKET or XDG_RUNTIME_DIR to something shorter"
    )]
    PathTooLong {
        /// The path.
        path: PathBuf,
        /// Its length.
        len_bytes: usize,
    },
    /// Another Manager holds this domain.
    #[error(
        "another Manager serves {path:?}: stop it, or choose another domain (--domain or SM2_DOMAIN)"
    )]
    Busy {
        /// The socket's path.
        path: PathBuf,
    },
    /// Any user could replace the socket.
    #[error(
        "directory {path:?} is writable for everybody (mode {mode:04o}): run 'chmod o-w' on it, or choose another place with SM2_SOCKET"
    )]
    DirectoryWritable {
        /// The directory.
        path: PathBuf,
        /// Its permission bits.
        mode: u32,
    },
    /// Another user could replace the socket.
    #[error(
        "directory {path:?} belongs to user {uid}, not to root or this process' user: choose another place with SM2_SOCKET"
    )]
    DirectoryOwner {
        /// The directory.
        path: PathBuf,
        /// Its owner.
        uid: u32,
    },
    /// There is a file where the socket should be.
    #[error(
        "{path:?} exists and is not a socket: remove it, or choose another path with SM2_SOCKET"
    )]
    NotASocket {
        /// The path.
        path: PathBuf,
    },
    /// What was handed over does not listen for connections.
    #[error(
        "the descriptor is not a listening AF_UNIX seqpacket socket: with systemd, use ListenSequentialPacket= in the socket unit"
    )]
    NotAListener {
        /// What the check said.
        source: io::Error,
    },
    /// A listening socket that was handed over has no path.
    #[error(
        "the listening socket is not bound to an absolute path: with systemd, use ListenSequentialPacket= with one that begins with '/'"
    )]
    NoPath,
    /// A socket that was handed over is not there any more.
    #[error("another Manager has replaced the socket at {path:?}: this one can only end")]
    Replaced {
        /// The socket's path.
        path: PathBuf,
    },
    /// The operating system refused.
    #[error("cannot {action} {path:?}: {source}{}", advice(source))]
    Io {
        /// What was tried.
        action: &'static str,
        /// On what.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

/// What to do about an error of the operating system, where one can know that.
fn advice(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::PermissionDenied => {
            "; choose a place of this user's: set XDG_RUNTIME_DIR, or SM2_SOCKET to a path in a folder of its own"
        }
        _ => "",
    }
}
