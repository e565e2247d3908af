//! The table of everything that SPEC forbids: for each violation the shortest bytes and the descriptors
//! that commit it.
//!
//! A [`Row`] is run against the side that must find the violation: a Manager ([`manager`]), a node that
//! receives from its Manager ([`node`]), or one end of a link ([`link`]). `tests/violations.rs` runs
//! all rows, and compares them with [`spec`].

mod frames;
pub mod link;
pub mod manager;
mod manager_rows;
pub mod node;
mod questions;
pub mod spec;
mod takeover;

use std::fmt;

use sm2_proto::ViolationKind;

/// One violation of SPEC, which is committed on a `Stage`.
pub struct Row<Stage: ?Sized> {
    /// The violation that the side must find.
    pub violation: ViolationKind,
    /// The clause that is broken (`SM2-TRN-004`), or the section.
    pub clause: &'static str,
    /// A description of the violation.
    pub what: String,
    /// Commits the violation.
    pub commit: Box<dyn Fn(&Stage)>,
}

/// A builder for the rows of one rule.
struct Rule<Stage: ?Sized> {
    violation: ViolationKind,
    clause: &'static str,
    rows: Vec<Row<Stage>>,
}

impl<Stage: ?Sized> Rule<Stage> {
    const fn new(violation: ViolationKind, clause: &'static str) -> Self {
        Self {
            violation,
            clause,
            rows: Vec::new(),
        }
    }

    fn row(mut self, what: impl Into<String>, commit: impl Fn(&Stage) + 'static) -> Self {
        self.rows.push(Row {
            violation: self.violation,
            clause: self.clause,
            what: what.into(),
            commit: Box::new(commit),
        });
        self
    }
}

impl<Stage: ?Sized> IntoIterator for Rule<Stage> {
    type Item = Row<Stage>;
    type IntoIter = std::vec::IntoIter<Self::Item>;

    fn into_iter(self) -> Self::IntoIter {
        self.rows.into_iter()
    }
}

impl<Stage: ?Sized> fmt::Display for Row<Stage> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} ({}): {}",
            self.violation.name(),
            self.clause,
            self.what
        )
    }
}
