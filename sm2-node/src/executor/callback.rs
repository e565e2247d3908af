//! The errors of an executor.

use std::error::Error;
use std::fmt;
use std::io;

use super::origin::Origin;

/// The error of a callback, which ends its executor.
pub type Failure = Box<dyn Error + Send + Sync>;

/// An executor ended without a shutdown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExecutorError {
    /// A callback returned this error.
    #[error("{origin} failed: {}", WithCauses(&**error))]
    Callback {
        /// The callback.
        origin: Origin,
        /// Its error.
        error: Failure,
    },
    /// The source of a callback cannot be added: too many descriptors, no memory, or a descriptor that cannot be
    /// waited for.
    #[error("the executor cannot wait for {origin}: {error}")]
    Source {
        /// The callback.
        origin: Origin,
        /// The error of the operating system.
        error: io::Error,
    },
    /// A thread cannot be started, or waiting failed.
    #[error("the executor cannot go on: {0}")]
    Io(io::Error),
}

/// The text of an error and of all its causes. The error of a callback comes from the program, so its text may leave
/// out its causes.
pub(crate) struct WithCauses<'a>(pub(crate) &'a (dyn Error + 'static));

impl fmt::Display for WithCauses<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(error) = self;
        write!(f, "{error}")?;
        let mut next = error.source();
        while let Some(cause) = next {
            write!(f, ": {cause}")?;
            next = cause.source();
        }
        Ok(())
    }
}
