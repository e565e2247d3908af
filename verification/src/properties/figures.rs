//! The page with the figures of a run.

use super::table::{escaped, render};
use super::{Outcome, Register, summary};

/// The tables of [`summary`], and one with a row for each check that reported.
#[must_use]
pub fn figures_page(register: &Register, outcomes: &[Outcome]) -> String {
    let mut lines = vec![
        "# Figures of the last run".to_owned(),
        String::new(),
        summary(register),
        String::new(),
        render(&["engine", "check", "figures", "seconds", "verdict"]),
        render(&["---"; 5]),
    ];
    lines.extend(outcomes.iter().map(|it| {
        render(&[
            it.engine.word(),
            &format!("`{}`", it.harness),
            &escaped(&it.covered),
            &format!("{:.1}", it.time_s),
            if it.held { "ok" } else { "FAILED" },
        ])
    }));
    lines.push(String::new());
    lines.join("\n")
}
