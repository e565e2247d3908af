//! The gaps that the check of clauses finds.

use std::fmt;
use std::io;
use std::path::PathBuf;

use super::ClauseId;

/// A line of a file; the path is relative to the workspace root.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct SourceLine {
    /// The file.
    pub file: PathBuf,
    /// The line, counted from 1.
    pub line: usize,
}

impl fmt::Display for SourceLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.file.display(), self.line)
    }
}

/// A disagreement between SPEC.md and the citations.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("{at}: {kind}")]
pub struct Gap {
    /// The line to look at.
    pub at: SourceLine,
    /// The kind of gap.
    pub kind: GapKind,
}

impl Gap {
    pub(super) const fn new(at: SourceLine, kind: GapKind) -> Self {
        Self { at, kind }
    }
}

/// How SPEC.md and its citations can disagree.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum GapKind {
    /// A line of SPEC.md resembles a clause but is malformed.
    #[error(
        "malformed clause line; expected `**SM2-XXX-000** [MUST|SHOULD|MAY|DRAFT] text` or \
         `~~SM2-XXX-000~~ [RETIRED]` at the start of the line"
    )]
    MalformedClause,
    /// An id names two clauses, or a clause and a retired one.
    #[error("{id} is used twice, first at {first}; ids are never used again")]
    DuplicateId {
        /// The id.
        id: ClauseId,
        /// Where it was used before.
        first: SourceLine,
    },
    /// SPEC.md refers to a clause that it does not have.
    #[error("the text refers to {id}, which is not a clause")]
    DanglingReference {
        /// The missing id.
        id: ClauseId,
    },
    /// A citation that cannot be read.
    #[error(
        "unreadable citation `{text}`; expected ids separated by commas, then optionally one of {}",
        super::CheckKind::NAMES
    )]
    UnreadableCitation {
        /// The line.
        text: String,
    },
    /// A citation of an id that SPEC.md does not have.
    #[error("unknown clause {id}")]
    UnknownId {
        /// The id.
        id: ClauseId,
    },
    /// A citation of a clause that is not yet in force.
    #[error("{id} is a DRAFT: cite it once it is in force")]
    CitesDraft {
        /// The id.
        id: ClauseId,
    },
    /// A citation of a clause that was withdrawn.
    #[error("{id} is RETIRED: nothing may cite it")]
    CitesRetired {
        /// The id.
        id: ClauseId,
    },
    /// A frame, code or fate of a table that no procedure of Annex B mentions.
    #[error("no procedure of Annex B mentions {name}")]
    NoProcedure {
        /// The name.
        name: String,
    },
    /// A MUST that no code cites.
    #[error("{id}: no code cites this MUST")]
    NoCode {
        /// The id.
        id: ClauseId,
    },
    /// A MUST that no check cites.
    #[error("{id}: no check cites this MUST")]
    NoCheck {
        /// The id.
        id: ClauseId,
    },
}

/// The reason why the check cannot run.
#[derive(Debug, thiserror::Error)]
pub enum CheckError {
    /// There is nothing to check against.
    #[error("{} is missing; name the workspace root as the argument", .0.display())]
    NoSpec(PathBuf),
    /// A file or folder cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The path of the file or folder.
        path: PathBuf,
        /// The error of the system.
        r#source: io::Error,
    },
}
