//! The programs of a robot, as `robot.toml` describes them.

use std::{path::PathBuf, time::Duration};

use serde::Deserialize;

use crate::wait_for::Expression;

/// A checked file.
#[derive(Clone, Debug)]
pub(super) struct Robot {
    /// The name of the file without its extension.
    pub(super) name: String,
    /// The domain of all programs.
    pub(super) domain: Option<String>,
    /// Whether a Manager is started if none serves.
    pub(super) has_manager: bool,
    /// The time from SIGTERM to SIGKILL.
    pub(super) stop_timeout: Duration,
    /// The programs, in the order of the file.
    pub(super) programs: Vec<Program>,
}

/// A program.
#[derive(Clone, Debug)]
pub(super) struct Program {
    pub(super) name: String,
    /// The program with its arguments. A program with a `/` in its name is an absolute path.
    pub(super) command: Vec<String>,
    /// The working directory.
    pub(super) folder: PathBuf,
    /// Its additional environment variables.
    pub(super) environment: Vec<(String, String)>,
    pub(super) policy: RestartPolicy,
    /// How often it is started again at most.
    pub(super) max_restarts: u32,
    /// The conditions that must hold before it starts.
    pub(super) after: Vec<Expression>,
}

/// The ends of a program after which it is started again.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum RestartPolicy {
    Never,
    /// A status other than 0, or a signal.
    #[default]
    OnFailure,
    Always,
}

impl RestartPolicy {
    /// The word in the file, which is also that of systemd.
    pub(super) const fn word(self) -> &'static str {
        match self {
            Self::Never => "no",
            Self::OnFailure => "on-failure",
            Self::Always => "always",
        }
    }
}
