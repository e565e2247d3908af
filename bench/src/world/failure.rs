//! Reasons why a case failed.

use std::{fmt::Display, io, time::Duration};

use crate::{disk::DiskError, job::ProcessEvent, link::LinkError};

/// The reason why a case has no figures.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// A process reported an error.
    #[error("{process}: {reason}")]
    Reported {
        /// The name of the process.
        process: String,
        /// The reason that it reported.
        reason: String,
    },
    /// A process ended without a report.
    #[error("{process} ended without a report: {status}{}", in_brackets(.stderr))]
    Ended {
        /// The name of the process.
        process: String,
        /// The exit status.
        status: String,
        /// The last line of its standard error.
        stderr: String,
    },
    /// A process took too long.
    #[error("{process} did not {action} within {limit:?}{}", in_brackets(.stderr))]
    TimedOut {
        /// The name of the process.
        process: String,
        /// The action that was expected of it.
        action: &'static str,
        /// The longest time that the action may take.
        limit: Duration,
        /// The last line of its standard error.
        stderr: String,
    },
    /// A process sent another line than the expected one.
    #[error("{process} sent {event:?} when it was expected to {action}")]
    Unexpected {
        /// The name of the process.
        process: String,
        /// The line that it sent.
        event: Box<ProcessEvent>,
        /// The action that was expected of it.
        action: &'static str,
    },
    /// SIGINT or SIGTERM ended the run.
    #[error("interrupted")]
    Interrupted,
    /// There is no link between the hosts of the case.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// There is no folder for the files of the case.
    #[error(transparent)]
    Disk(#[from] DiskError),
    /// A recorded file cannot be read.
    #[error("cannot read the recorded file: {reason}")]
    Content {
        /// The reason.
        reason: String,
    },
    /// A system call that every case needs has failed.
    #[error("cannot {action}: {source}")]
    Io {
        /// The action that failed.
        action: &'static str,
        /// The error of the system.
        r#source: io::Error,
    },
}

fn in_brackets(text: &str) -> String {
    match text {
        "" => String::new(),
        text => format!(" [{text}]"),
    }
}

impl Failure {
    /// Makes a failure of an error of a recorded file.
    pub fn content(error: impl Display) -> Self {
        let reason = error.to_string();
        Self::Content { reason }
    }

    pub(super) fn io(action: &'static str) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { action, source }
    }
}
