//! A check, and the properties that it shows.

use super::{Engine, Gap, GapKind};

/// The runs that a check is part of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Run {
    /// All runs.
    Quick,
    /// Only full runs.
    Full,
}

/// A check: a row of a table, an entry of a list, or the comment of a source.
#[derive(Clone, Debug)]
pub struct Check {
    /// The name under which the engine reports it.
    pub harness: String,
    /// The names of the properties that it shows.
    pub shows: Vec<String>,
    /// The engine that runs it.
    pub engine: Engine,
    /// The runs that it is part of.
    pub run: Run,
    /// The first word of its figures, if it is stated: `Exhaustive`.
    pub strength: Option<String>,
    /// The line of its row, counted from 1; `None` without a row.
    pub line: Option<usize>,
}

impl Check {
    /// A gap at its row.
    pub(super) const fn gap(&self, kind: GapKind) -> Gap {
        let line = self.line;
        Gap { line, kind }
    }
}
