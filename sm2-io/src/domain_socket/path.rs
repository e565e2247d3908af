//! The path of a domain's socket.

use std::ffi::OsString;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use super::error::DomainSocketError;
use super::limits::{MAX_DOMAIN_BYTES, MAX_PATH_BYTES};

/// The domain if none is named.
pub const DEFAULT_DOMAIN: &str = "default";

/// The path of a domain's socket, from the environment of this process.
///
/// | `domain` | path |
/// | --- | --- |
/// | given | `$XDG_RUNTIME_DIR/sm2/<domain>.sock`, else `/run/sm2/<domain>.sock` |
/// | `None` | `$SM2_SOCKET`, else as above with `$SM2_DOMAIN`, else `default` |
///
/// An empty variable counts as not set, and so does an `XDG_RUNTIME_DIR` that is not absolute.
///
/// # Errors
///
/// [`DomainSocketError::DomainName`], [`DomainSocketError::PathTooLong`].
pub fn socket_path(domain: Option<&str>) -> Result<PathBuf, DomainSocketError> {
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
) -> Result<PathBuf, DomainSocketError> {
    let variable = |name| variable(name).filter(|value| !value.is_empty());
    let path = match (domain, variable("SM2_SOCKET")) {
        (None, Some(path)) => PathBuf::from(path),
        (Some(domain), _) => in_directory(domain, variable("XDG_RUNTIME_DIR"))?,
        (None, None) => {
            let domain = variable("SM2_DOMAIN").unwrap_or_else(|| DEFAULT_DOMAIN.into());
            // Invalid UTF-8 becomes a replacement character, which the grammar of names rejects.
            in_directory(&domain.to_string_lossy(), variable("XDG_RUNTIME_DIR"))?
        }
    };
    check_path(&path)?;
    Ok(path)
}

//= SM2-TRN-002
fn in_directory(domain: &str, runtime: Option<OsString>) -> Result<PathBuf, DomainSocketError> {
    let legal = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'_' | b'-');
    if domain.is_empty() || domain.len() > MAX_DOMAIN_BYTES || !domain.bytes().all(legal) {
        return Err(DomainSocketError::DomainName {
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

/// Checks that a socket address can hold the path.
pub(crate) fn check_path(path: &Path) -> Result<(), DomainSocketError> {
    let len_bytes = path.as_os_str().as_bytes().len();
    if len_bytes > MAX_PATH_BYTES {
        return Err(DomainSocketError::PathTooLong {
            path: path.to_owned(),
            len_bytes,
        });
    }
    Ok(())
}
