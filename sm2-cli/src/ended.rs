//! The results of commands, and the exit statuses that several files use.

use crate::interrupt::Stopped;

/// The exit status of a command line that is not understood.
pub(crate) const WRONG_USAGE: u8 = 2;

/// The exit status of a command whose answer is that something is there and does not work.
pub(crate) const NOT_WORKING: u8 = 3;

/// The result of a command that did not fail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Ended {
    /// The command is done, or a signal ended a command that has no other end.
    Done,
    /// The command is done, and its answer is no. The answer has been printed.
    No,
    /// The command is done, and its answer is that the interfaces are linked, but not working. The answer has been
    /// printed.
    NotWorking,
    /// A signal came before the command was done.
    Stopped(Stopped),
}

impl Ended {
    /// The result of a command that is done, and whose answer is yes or no.
    pub(crate) const fn with_answer(is_yes: bool) -> Self {
        match is_yes {
            true => Self::Done,
            false => Self::No,
        }
    }
}
