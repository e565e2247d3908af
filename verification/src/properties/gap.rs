//! Disagreements between PROPERTIES.md and a run.

use std::fmt;

use super::Engine;

/// A disagreement, and its line.
#[derive(Debug, PartialEq, Eq)]
pub struct Gap {
    /// The line of PROPERTIES.md, counted from 1; `None` for a check without a row.
    pub line: Option<usize>,
    /// The kind of gap.
    pub kind: GapKind,
}

impl Gap {
    pub(super) const fn at(line: usize, kind: GapKind) -> Self {
        Self {
            line: Some(line),
            kind,
        }
    }
}

impl fmt::Display for Gap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            Some(line) => write!(f, "PROPERTIES.md:{line}: {}", self.kind),
            None => write!(f, "{}", self.kind),
        }
    }
}

/// How claims and checks can disagree.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum GapKind {
    /// A row with a wrong format.
    #[error("a row has as many cells as its header, and one space on each side of them")]
    Untidy,
    /// A name of a check without quotes.
    #[error("`{0}` is not the name of a check between backticks")]
    Harness(String),
    /// An unknown engine.
    #[error("there is no engine `{0}`")]
    Engine(String),
    /// A run other than `quick` and `full`.
    #[error("a check is run `quick` or `full`, not `{0}`")]
    Run(String),
    /// A word that is not the id of a clause.
    #[error("`{0}` is not the id of a clause")]
    Clause(String),
    /// A clause that SPEC.md does not have in force.
    #[error("SPEC.md has no clause {0} in force")]
    UnknownClause(String),
    /// An engine without a row in the table of engines.
    #[error("{0} has no row in the table of engines")]
    NoEngine(Engine),
    /// Two rows with one name.
    #[error("{0} has two rows")]
    Twice(String),
    /// A property whose prefix belongs to no group.
    #[error("{0} belongs to no row of the table of groups")]
    NoGroup(String),
    /// A property without a check.
    #[error("no check shows {0}")]
    Unshown(String),
    /// A check that shows no property: the comment of a harness is missing, or cannot be read.
    #[error("{0} shows no property; a harness says it by `// Shows NAME (STRENGTH), bound: TEXT.`")]
    NoClaim(String),
    /// A check of an unknown property.
    #[error("there is no property {0}")]
    UnknownProperty(String),
    /// A row without a result, although its engine ran.
    #[error("{engine} reported no check `{harness}`")]
    Silent {
        /// The engine that ran.
        engine: Engine,
        /// The missing harness.
        harness: String,
    },
    /// A row of a full run whose check the engine does not list.
    #[error("{engine} has no check `{harness}`")]
    Unlisted {
        /// The engine that was asked.
        engine: Engine,
        /// The missing harness.
        harness: String,
    },
    /// A check that ran, and has neither a comment nor a row.
    #[error(
        "{engine} ran `{harness}`, which shows no property: add `// Shows NAME ({engine}), bound: TEXT.`"
    )]
    NoRow {
        /// The engine that ran it.
        engine: Engine,
        /// The harness that ran.
        harness: String,
    },
    /// A check that covers less than expected.
    #[error("{engine} `{harness}`: expected {wanted}, the run says `{now}`")]
    Less {
        /// The engine that ran it.
        engine: Engine,
        /// The harness that ran.
        harness: String,
        /// The expectation.
        wanted: String,
        /// The figures of the run.
        now: String,
    },
}
