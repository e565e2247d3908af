//! The error type of roles.

/// Any error that ends a role.
pub(super) type Failure = Box<dyn std::error::Error>;
