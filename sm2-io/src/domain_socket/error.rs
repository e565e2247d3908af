//! Errors of a domain's socket.

use std::io;
use std::path::PathBuf;

use super::limits::{MAX_DOMAIN_BYTES, MAX_PATH_BYTES};

/// Why a domain's socket cannot be named or bound. Each text says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DomainSocketError {
    /// The name of the domain breaks the grammar.
    #[error(
        "domain name {name:?}: use 1 to {MAX_DOMAIN_BYTES} letters, digits, '_' or '-' (from --domain or SM2_DOMAIN)"
    )]
    DomainName {
        /// The name as it was given.
        name: String,
    },
    /// The path does not fit a socket address.
    #[error(
        "socket path {path:?} has {len_bytes} bytes, {MAX_PATH_BYTES} are possible: \
         set SM2_SOCKET or XDG_RUNTIME_DIR to something shorter"
    )]
    PathTooLong {
        /// The path.
        path: PathBuf,
        /// Its length.
        len_bytes: usize,
    },
    /// Another Manager owns the socket of this domain.
    #[error(
        "another Manager serves {path:?}: stop it, or choose another domain (--domain or SM2_DOMAIN)"
    )]
    Busy {
        /// The socket's path.
        path: PathBuf,
    },
    /// Any user could replace the socket.
    #[error(
        "directory {path:?} is writable for all users (mode {mode:04o}): \
         run 'chmod o-w' on it, or choose another path with SM2_SOCKET"
    )]
    DirectoryWritable {
        /// The directory.
        path: PathBuf,
        /// Its permission bits.
        mode: u32,
    },
    /// Another user could replace the socket.
    #[error(
        "directory {path:?} belongs to user {uid}, not to root or the user of this process: \
         choose another path with SM2_SOCKET"
    )]
    DirectoryOwner {
        /// The directory.
        path: PathBuf,
        /// Its owner.
        uid: u32,
    },
    /// The path names a file that is not a socket.
    #[error(
        "{path:?} exists and is not a socket: remove it, or choose another path with SM2_SOCKET"
    )]
    NotASocket {
        /// The path.
        path: PathBuf,
    },
    /// The descriptor that was passed is not a listening socket.
    #[error(
        "the descriptor is not a listening AF_UNIX seqpacket socket: \
         with systemd, use ListenSequentialPacket= in the socket unit"
    )]
    NotAListener {
        /// The error of the check.
        source: io::Error,
    },
    /// The listening socket that was passed has no path.
    #[error(
        "the listening socket is not bound to an absolute path: \
         with systemd, use ListenSequentialPacket= with one that begins with '/'"
    )]
    NoPath,
    /// A successor has replaced the socket.
    #[error("another Manager has replaced the socket at {path:?}: this one can only exit")]
    Replaced {
        /// The socket's path.
        path: PathBuf,
    },
    /// The operating system refused.
    #[error("cannot {action} {path:?}: {source}{}", advice(source))]
    Io {
        /// The operation that failed.
        action: &'static str,
        /// The path of the operation.
        path: PathBuf,
        /// The error of the operating system.
        r#source: io::Error,
    },
}

/// Advice for an error of the operating system, if there is any.
fn advice(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::PermissionDenied => {
            "; choose a directory of this user: set XDG_RUNTIME_DIR, or SM2_SOCKET to a path in a directory of its own"
        }
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_of_another_user_comes_with_advice() {
        let text = |kind: io::ErrorKind| advice(&kind.into());
        let denied = text(io::ErrorKind::PermissionDenied);
        assert!(
            denied.starts_with("; choose a directory of this user"),
            "{denied}"
        );
        assert_eq!(text(io::ErrorKind::NotFound), "");
    }
}
