//! The errors of an executor.

use std::error::Error;
use std::io;

use super::origin::Origin;

/// The error of a callback, which ends its executor.
pub type Failure = Box<dyn Error + Send + Sync>;

/// An executor ended without a shutdown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExecutorError {
    /// A callback returned this error.
    #[error("{origin} failed: {error}")]
    Callback {
        /// The callback.
        origin: Origin,
        /// Its error.
        #[source]
        error: Failure,
    },
    /// The source of a callback cannot be added: too many descriptors, no memory, or a descriptor that cannot be
    /// waited for.
    #[error("the executor cannot wait for {origin}: {error}")]
    Source {
        /// The callback.
        origin: Origin,
        /// The error of the operating system.
        #[source]
        error: io::Error,
    },
    /// A thread cannot be started, or waiting failed.
    #[error("the executor cannot go on: {0}")]
    Io(#[source] io::Error),
}
