//! How a command ends: its result, and the exit statuses that several files name.

use crate::interrupt::Stopped;

/// The exit status of a command line that is not understood.
pub(crate) const WRONG_USAGE: u8 = 2;

/// How a command ended that did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ended {
    /// All was done, or it was stopped where that is how it ends.
    Done,
    /// All was done, and the answer is no; what it says is said already.
    No,
    /// A signal came before all was done.
    Stopped(Stopped),
}
