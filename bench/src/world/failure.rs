//! What can go wrong in a case.

use std::{io, time::Duration};

use crate::{job::Said, link::LinkError};

/// Why a case has no figures.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// A process said why it cannot go on.
    #[error("{process}: {reason}")]
    Said {
        /// Which one.
        process: String,
        /// What it said.
        reason: String,
    },
    /// A process ended without a word.
    #[error("{process} ended without a word: {status}{}", in_brackets(.stderr))]
    Ended {
        /// Which one.
        process: String,
        /// How.
        status: String,
        /// The end of its standard error.
        stderr: String,
    },
    /// A process took too long.
    #[error("{process} did not {action} within {limit:?}{}", in_brackets(.stderr))]
    TimedOut {
        /// Which one.
        process: String,
        /// What it was to do.
        action: &'static str,
        /// How long that may take.
        limit: Duration,
        /// The end of its standard error.
        stderr: String,
    },
    /// A process said something else than was expected.
    #[error("{process} said {said:?} when it was to {action}")]
    Unexpected {
        /// Which one.
        process: String,
        /// What it said.
        said: Box<Said>,
        /// What it was to do.
        action: &'static str,
    },
    /// The person at the keyboard has had enough.
    #[error("interrupted")]
    Interrupted,
    /// The hosts of the case have no way to each other.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The system refused what every case needs.
    #[error("cannot {action}: {source}")]
    Io {
        /// What was tried.
        action: &'static str,
        /// What the system said.
        source: io::Error,
    },
}

fn in_brackets(text: &str) -> String {
    match text {
        "" => String::new(),
        text => format!(" [{text}]"),
    }
}

impl Failure {
    pub(super) fn io(action: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { action, source }
    }
}
