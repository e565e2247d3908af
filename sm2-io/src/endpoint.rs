//! Where a domain's socket is, and what can be wrong with that place.

use std::ffi::OsString;
use std::io;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

/// The longest path of a domain's socket, in bytes: a socket address has room for
/// 107, and one is needed for the temporary name in [`Claim`](crate::Claim).
pub const MAX_PATH_BYTES: usize = 106;

/// The longest name of a domain, in bytes.
pub const MAX_DOMAIN_BYTES: usize = 64;

/// The domain where none is named.
pub const DEFAULT_DOMAIN: &str = "default";

/// The path of a domain's socket, from the environment of this process.
///
/// | `domain` | path |
/// | --- | --- |
/// | given | `$XDG_RUNTIME_DIR/sm2/<domain>.sock`, else `/run/sm2/<domain>.sock` |
/// | `None` | `$SM2_SOCKET`, else as above with `$SM2_DOMAIN`, else `default` |
///
/// A variable that is empty counts as not set, and so does an `XDG_RUNTIME_DIR` that
/// is not absolute.
///
/// # Errors
///
/// [`EndpointError::DomainName`], [`EndpointError::PathTooLong`].
pub fn socket_path(domain: Option<&str>) -> Result<PathBuf, EndpointError> {
    socket_path_in(domain, |name| std::env::var_os(name))
}

/// As [`socket_path`], in the environment that `variable` looks up.
///
/// # Errors
///
/// As [`socket_path`].
//= SM2-TRN-001
pub fn socket_path_in(
    domain: Option<&str>,
    variable: impl Fn(&str) -> Option<OsString>,
) -> Result<PathBuf, EndpointError> {
    let variable = |name| variable(name).filter(|value| !value.is_empty());
    let path = match (domain, variable("SM2_SOCKET")) {
        (None, Some(path)) => PathBuf::from(path),
        (Some(domain), _) => in_directory(domain, variable("XDG_RUNTIME_DIR"))?,
        (None, None) => {
            let domain = variable("SM2_DOMAIN").unwrap_or_else(|| DEFAULT_DOMAIN.into());
            // What is not UTF-8 keeps a replacement character, which no name has.
            in_directory(&domain.to_string_lossy(), variable("XDG_RUNTIME_DIR"))?
        }
    };
    check_path(&path)?;
    Ok(path)
}

//= SM2-TRN-002
fn in_directory(domain: &str, runtime: Option<OsString>) -> Result<PathBuf, EndpointError> {
    let legal = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'-');
    if domain.is_empty() || domain.len() > MAX_DOMAIN_BYTES || !domain.bytes().all(legal) {
        return Err(EndpointError::DomainName {
            name: domain.to_owned(),
        });
    }
    let mut path = runtime
        .map(PathBuf::from)
        .filter(|path| path.is_absolute())
        .unwrap_or_else(|| PathBuf::from("/run"));
    path.push("sm2");
    path.push(format!("{domain}.sock"));
    Ok(path)
}

/// That a socket address can hold the path.
pub(crate) fn check_path(path: &Path) -> Result<(), EndpointError> {
    let len_bytes = path.as_os_str().as_bytes().len();
    if len_bytes > MAX_PATH_BYTES {
        return Err(EndpointError::PathTooLong {
            path: path.to_owned(),
            len_bytes,
        });
    }
    Ok(())
}

/// Why a domain's socket cannot be named or claimed. Each says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EndpointError {
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
