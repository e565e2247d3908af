//! Expected counts of states.

use std::{fmt, io};

use super::Report;
use crate::results;

/// A file of expected counts, with a line for each scope.
#[derive(Clone, Copy, Debug)]
pub struct Golden {
    pub(super) file: &'static str,
    pub(super) text: &'static str,
}

impl Golden {
    /// The scopes that have counts, in their order.
    pub fn scopes(self) -> impl Iterator<Item = &'static str> {
        let lines = self.text.lines().filter(|line| !line.starts_with('#'));
        lines.filter_map(|line| line.split(' ').next())
    }

    /// True if a search has the expected counts.
    #[must_use]
    pub fn has<A>(self, scope: &str, report: &Report<A>) -> bool {
        let counts = counts(scope, report);
        self.text.lines().any(|line| line == counts)
    }

    /// Prints the findings of a search, and appends them to the other [`results`]. Returns true if
    /// every property held and the counts are the expected ones.
    ///
    /// # Errors
    ///
    /// The findings cannot be printed or appended.
    pub fn tell<A: fmt::Display>(
        self,
        out: &mut impl io::Write,
        scope: &str,
        report: &Report<A>,
    ) -> io::Result<bool> {
        writeln!(out, "{scope}: {report}, {:.1} s", report.time.as_secs_f64())?;
        if report.cut_short {
            writeln!(out, "  stopped at {} states", report.states)?;
        }
        let mut holds = !report.cut_short;
        if let Some(found) = &report.failure {
            writeln!(out, "  {}", found.failure)?;
            for (step, action) in (1..).zip(&found.steps) {
                writeln!(out, "  {step:3} {action}")?;
            }
            holds = false;
        } else if !self.has(scope, report) {
            let counts = counts(scope, report);
            writeln!(out, "  {} does not have: {counts}", self.file)?;
            holds = false;
        }
        let covered = report.to_string();
        results::append(&results::line("model", scope, holds, report.time, &covered))?;
        Ok(holds)
    }
}

fn counts<A>(scope: &str, report: &Report<A>) -> String {
    let Report {
        states,
        transitions,
        depth,
        quiet,
        ..
    } = report;
    format!("{scope} {states} {transitions} {depth} {quiet}")
}
