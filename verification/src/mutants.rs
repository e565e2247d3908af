//! Whether the checks bite: faults of the shipped code, each with the check that has to find it.
//!
//! `mutants.toml` beside this crate is the one place where they stand. A [`Mutant`] is a text
//! that the code has exactly once, and what to put there instead; a [`Campaign`] copies the
//! workspace, sees that every check holds there, and then makes one fault after the other.
//! Faults of what threads share are made in `loom-models/build.rs`, and only there.

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

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum MutantsError {
    /// A file or folder cannot be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// The system's answer.
        source: io::Error,
    },
    /// The list of mutants is none.
    #[error("{}: {source}", path.display())]
    Catalogue {
        /// Where it stands.
        path: PathBuf,
        /// The error of the parser.
        source: toml::de::Error,
    },
    /// A mutant cannot be made.
    #[error(transparent)]
    Gap(Gap),
    /// The tool or a check does not start.
    #[error("cannot run {}: {source}", program.display())]
    Start {
        /// Which.
        program: PathBuf,
        /// The system's answer.
        source: io::Error,
    },
    /// The workspace does not build even without a fault.
    #[error("the checks do not build without a mutant:\n{0}")]
    Broken(String),
    /// Cargo built something and not the check.
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
