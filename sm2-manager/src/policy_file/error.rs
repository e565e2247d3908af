//! The errors of policy files.

use std::{io, path::PathBuf};

use sm2_proto::{
    Name, WrongText,
    control::PolicyProblem,
    limits::POLICY_FILE_MAX,
    policy::{PolicyError, UnknownAction},
};

/// Why a policy file was refused.
#[derive(Debug, thiserror::Error)]
pub enum PolicyFileError {
    /// The file cannot be read.
    #[error("cannot read the policy {path:?}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The error of the system.
        r#source: io::Error,
    },
    /// The path names a folder, a device or another special file.
    #[error("the policy {path:?} is not a regular file: name a TOML file")]
    NotAFile {
        /// The path.
        path: PathBuf,
    },
    /// Another user can change the file.
    #[error(
        "the policy {path:?} belongs to user {uid} and has the mode {mode:o}: let root or the Manager's user \
         own it, and nobody else write it"
    )]
    NotTrusted {
        /// The file.
        path: PathBuf,
        /// The owner.
        uid: u32,
        /// The permissions.
        mode: u32,
    },
    /// The Manager cannot link the policy to its domain.
    #[error("cannot make {path:?} a link to the policy: {source}")]
    NotLinked {
        /// The path of the link.
        path: PathBuf,
        /// The error of the system.
        r#source: io::Error,
    },
    /// The file is too long.
    #[error(
        "the policy {path:?} is longer than {POLICY_FILE_MAX} bytes: use patterns with `*` and `**`"
    )]
    TooLong {
        /// The file.
        path: PathBuf,
    },
    /// The file is not TOML, or a key is unknown, missing or of the wrong type.
    #[error("{path}:{line}: {}", .source.message(), path = .path.display())]
    Toml {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The error of the parser.
        r#source: Box<toml::de::Error>,
    },
    /// A value is not allowed.
    #[error("{path}:{line}: {key}: {source}", path = .path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// The key of the value.
        key: &'static str,
        /// The error in the value.
        r#source: PolicyValueError,
    },
    /// The tables together are not a policy.
    #[error("{path}:{line}: {source}", path = .path.display())]
    Policy {
        /// The file.
        path: PathBuf,
        /// The line, from 1, of the table with a name that an earlier one has; else of the last table.
        line: usize,
        /// The error.
        r#source: PolicyError,
    },
}

impl PolicyFileError {
    /// The kind of problem, as RELOADED names it.
    //= SM2-ACC-016
    pub(crate) const fn problem(&self) -> PolicyProblem {
        match self {
            Self::Io { .. } | Self::NotAFile { .. } | Self::NotLinked { .. } => {
                PolicyProblem::Unreadable
            }
            Self::NotTrusted { .. } => PolicyProblem::NotTrusted,
            Self::TooLong { .. } | Self::Toml { .. } | Self::Value { .. } | Self::Policy { .. } => {
                PolicyProblem::Invalid
            }
        }
    }
}

/// Why a value of a policy file was refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PolicyValueError {
    /// The value is not a name or a pattern of names.
    #[error(transparent)]
    Text(#[from] WrongText),
    /// The value is not an action.
    #[error("`{text}`: {source}")]
    Action {
        /// The text.
        text: String,
        /// The rule that it breaks.
        r#source: UnknownAction,
    },
    /// A list has no members, so its table could never match.
    #[error("an empty list matches nothing: name at least one, or omit the key")]
    Empty,
    /// The system has no such user.
    #[error("this machine has no user `{text}`: correct the name, or write the user id")]
    NoUser {
        /// The name.
        text: String,
    },
    /// The system has no such group.
    #[error("this machine has no group `{text}`: correct the name, or write the group id")]
    NoGroup {
        /// The name.
        text: String,
    },
    /// The system cannot look up a user or group.
    #[error("cannot look up `{text}` ({source}): write the id in place of the name")]
    Lookup {
        /// The name.
        text: String,
        /// The error of the system.
        r#source: io::Error,
    },
}

/// A part of a policy that probably does not do what its author expects.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum PolicyWarning {
    /// A rule depends on a name that any process may choose.
    #[error(
        "rule `{rule}` in line {line} gives rights to `{pattern}` by name alone, and every process may \
         use that name: add `users` or `groups` to the rule, or a [[binding]] of that name"
    )]
    UnboundName {
        /// The name of the rule.
        rule: Name,
        /// Its line.
        line: usize,
        /// The pattern of node names.
        pattern: String,
    },
    /// An earlier rule for all subjects, actions and names decides everything.
    #[error("rule `{rule}` in line {line} is never reached: rule `{earlier}` matches everything")]
    NeverReached {
        /// The name of the rule.
        rule: Name,
        /// Its line.
        line: usize,
        /// The earlier rule.
        earlier: Name,
    },
}
