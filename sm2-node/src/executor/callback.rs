//! Callbacks of an executor, and their errors.

use std::error::Error;
use std::io;

/// Identifies a callback of an [`Executor`](crate::Executor).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct CallbackId(pub(super) u64);

/// The error of a callback, which ends its executor.
pub type Failure = Box<dyn Error + Send + Sync>;

/// An executor ended without a shutdown.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExecutorError {
    /// A callback returned this error.
    #[error("a callback failed: {0}")]
    Callback(#[source] Failure),
    /// A source cannot be added, a thread cannot be started, or waiting failed.
    #[error("the executor cannot go on: {0}")]
    Io(#[source] io::Error),
}
