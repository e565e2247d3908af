//! How long the name of a domain and the path of its socket may be.

/// The longest path of a domain's socket, in bytes: a socket address has room for
/// 107, and one is needed for the temporary name in [`BindOptions`](crate::Claim).
pub const MAX_PATH_BYTES: usize = 106;

/// The longest name of a domain, in bytes.
pub const MAX_DOMAIN_BYTES: usize = 64;
