//! The table at the end of a run.

use std::fmt::Write as _;

use sm2_verification::properties::Register;

use crate::run::Ran;
use crate::verdict::Verdict;

const HEADER: [&str; 6] = ["property", "engine", "check", "covered", "time", "verdict"];
/// The largest width of a column; longer cells do not widen it.
const WIDEST: usize = 64;

/// A line for each check that reported, and one for each engine that did not run to its end.
pub(crate) fn render(register: &Register, runs: &[Ran]) -> String {
    let mut lines = vec![HEADER.map(str::to_owned)];
    for ran in runs {
        for outcome in &ran.outcomes {
            let check = register.check(ran.engine, &outcome.harness);
            lines.push([
                check.map_or_else(|| "no row".to_owned(), |it| shown(&it.shows)),
                ran.engine.to_string(),
                outcome.harness.clone(),
                outcome.covered.clone(),
                format!("{:.1}", outcome.time_s),
                if outcome.held { "ok" } else { "FAILED" }.to_owned(),
            ]);
        }
        let (word, why) = match &ran.verdict {
            Verdict::Held => continue,
            Verdict::Skipped { why } => ("skipped", why),
            Verdict::Failed { why } => ("FAILED", why),
        };
        lines.push([
            format!("{} checks", register.of(ran.engine).count()),
            ran.engine.to_string(),
            "(as a whole)".to_owned(),
            why.clone(),
            format!("{:.1}", ran.time_s),
            word.to_owned(),
        ]);
    }
    aligned(&lines)
}

/// The first name, and the number of the others.
fn shown(names: &[String]) -> String {
    match names {
        [] => "-".to_owned(),
        [one] => one.clone(),
        [first, more @ ..] => format!("{first} +{}", more.len()),
    }
}

fn aligned(lines: &[[String; 6]]) -> String {
    let width = |column: usize| {
        let lengths = lines.iter().map(|it| it[column].chars().count());
        lengths.filter(|it| *it <= WIDEST).max().unwrap_or_default()
    };
    let widths: [usize; 6] = std::array::from_fn(width);
    let mut text = String::new();
    for line in lines {
        for (cell, width) in line.iter().zip(widths) {
            // Writing to a string does not fail.
            let _ = write!(text, "{cell:<width$}  ");
        }
        text.truncate(text.trim_end().len());
        text.push('\n');
    }
    text
}
