//! The limits of names and paths.

/// The longest path of a domain's socket, in bytes: a socket address has room for 107, and the
/// temporary name in [`DomainLock::bind`](crate::DomainLock::bind) needs one more byte.
pub const MAX_PATH_BYTES: usize = 106;

/// The longest name of a domain, in bytes.
pub const MAX_DOMAIN_BYTES: usize = 64;
