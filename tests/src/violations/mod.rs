//! The table of everything that SPEC forbids: for each way to break it the least
//! bytes and descriptors that do.
//!
//! A [`Row`] is run against the side that has to notice: a Manager ([`manager`]),
//! a node that hears from its Manager ([`node`]), or one end of a link ([`link`]).
//! `tests/violations.rs` runs them, and holds them against [`spec`].

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

/// One way to break SPEC, told to a `Stage` that has all that it takes.
pub struct Row<Stage: ?Sized> {
    /// What has to come back.
    pub violation: ViolationKind,
    /// The clause that is broken (`SM2-TRN-004`), or the section.
    pub clause: &'static str,
    /// How.
    pub what: String,
    /// Does it.
    pub commit: Box<dyn Fn(&Stage)>,
}

/// The rows of one rule, put down one after the other.
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
