//! Faults in the shipped code, each with the check that must find it.
//!
//! `mutants.toml` beside this crate lists them. A [`Mutant`] is a text that the code has exactly once,
//! and its replacement. A [`Campaign`] copies the workspace, checks that every check passes there, and
//! then makes one fault after the other. Faults in code that threads share are made only in
//! `loom-models/build.rs`.

mod campaign;
mod catalogue;
mod check;
mod outcome;
mod tree;

use std::{io, path::PathBuf};

pub use self::{
    campaign::Campaign,
    catalogue::{Catalogue, Check, Gap, Mutant},
    outcome::{Killed, Outcome, Verdict},
};

/// The reason why a campaign cannot run.
#[derive(Debug, thiserror::Error)]
pub enum MutantsError {
    /// A file or folder cannot be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The path of the file or folder.
        path: PathBuf,
        /// The error of the system.
        r#source: io::Error,
    },
    /// The list of mutants is invalid.
    #[error("{}: {source}", path.display())]
    Catalogue {
        /// The path of the list.
        path: PathBuf,
        /// The error of the parser.
        r#source: toml::de::Error,
    },
    /// A mutant cannot be made.
    #[error(transparent)]
    Gap(Gap),
    /// The tool or a check does not start.
    #[error("cannot run {}: {source}", program.display())]
    Start {
        /// The path of the program.
        program: PathBuf,
        /// The error of the system.
        r#source: io::Error,
    },
    /// The workspace does not build even without a fault.
    #[error("the checks do not build without a mutant:\n{0}")]
    Broken(String),
    /// Cargo succeeded without building the check.
    #[error("cargo built no {0}")]
    NoExecutable(String),
}

impl MutantsError {
    fn file(path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        |source| Self::File { path, source }
    }

    fn start(program: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let program = program.into();
        |source| Self::Start { program, source }
    }
}
