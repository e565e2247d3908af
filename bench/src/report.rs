//! Reports of results: tables for terminals, lines of JSON, and tables in a Markdown document.

use std::{fmt::Write, fs, io, path::Path};

use crate::{
    format::number,
    results::{PeerFigure, Results, join},
    workloads,
};

/// The lines before and after the tables in a document.
const MARKS: [&str; 2] = ["<!-- results: begin -->", "<!-- results: end -->"];

/// Median, range and ratio.
fn cell(figure: &PeerFigure) -> String {
    let summary = figure.summary;
    let mut text = number(summary.median);
    if summary.min != summary.max {
        let _ = write!(text, " ({}-{})", number(summary.min), number(summary.max));
    }
    if let Some(ratio) = figure.ratio_to_sm2
        && figure.peer != "sm2"
    {
        let _ = write!(text, " {}x", number(ratio));
    }
    text
}

/// The cases, and for each the figures that are the columns of its table.
fn columns(results: &Results) -> Vec<(String, Vec<String>)> {
    let shown = workloads::find(&results.workload).map_or(&[][..], |workload| workload.shown);
    let has = |name: &String| results.figures.iter().any(|figure| figure.figure == *name);
    let case = |case: String| {
        let names = shown.iter().map(|figure| join(&case, figure));
        let names = names.filter(has).collect();
        (case, names)
    };
    results.cases().into_iter().map(case).collect()
}

/// The rows of the table of a case; the first one has the headings.
fn rows(results: &Results, case: &str, names: &[String]) -> Vec<Vec<String>> {
    let head = names.iter().map(|name| {
        let unit = results.figures.iter().find(|figure| figure.figure == *name);
        let unit = unit.map_or("", |figure| &figure.unit);
        format!("{}, {unit}", crate::results::split(name).1)
    });
    let mut rows = vec![[case.to_owned()].into_iter().chain(head).collect()];
    for peer in results.peers() {
        let of = |name: &String| results.find(peer, name).map(cell);
        let cells: Vec<_> = names.iter().map(of).collect();
        let failed = results
            .failures
            .iter()
            .filter(|failure| failure.peer == peer && failure.case == case)
            .count();
        if failed == 0 && cells.iter().all(Option::is_none) {
            continue;
        }
        let name = match failed {
            0 => peer.to_owned(),
            failed => format!("{peer} (failed {failed} of {})", results.repeats),
        };
        let cells = cells.into_iter().map(Option::unwrap_or_default);
        rows.push([name].into_iter().chain(cells).collect());
    }
    rows
}

/// All tables, as text for a terminal.
#[must_use]
pub fn table(results: &Results) -> String {
    let mut text = format!(
        "{}, read {}, {} repeats: median (least-greatest), ratio to sm2\n",
        results.workload,
        results.read.as_str(),
        results.repeats
    );
    for (case, names) in columns(results) {
        let rows = rows(results, &case, &names);
        let width = |column: usize| {
            let cells = rows.iter().map(|row| row[column].chars().count());
            cells.max().unwrap_or(0)
        };
        let widths: Vec<_> = (0..=names.len()).map(width).collect();
        text.push('\n');
        for row in &rows {
            let cells = row.iter().zip(&widths);
            let cells: Vec<_> = cells
                .map(|(cell, width)| format!("{cell:width$}"))
                .collect();
            text.push_str(cells.join("  ").trim_end());
            text.push('\n');
        }
    }
    for failure in &results.failures {
        let _ = writeln!(
            text,
            "{} failed in repeat {} {}: {}",
            failure.peer, failure.repeat, failure.case, failure.failed
        );
    }
    text
}

/// One JSON object per line: one for each peer and figure, then one for each failure.
///
/// # Errors
///
/// A figure cannot be serialized, which does not happen with finite numbers.
pub fn json_lines(results: &Results) -> serde_json::Result<String> {
    let figures = results.figures.iter().map(serde_json::to_string);
    let failures = results.failures.iter().map(serde_json::to_string);
    let lines: serde_json::Result<Vec<_>> = figures.chain(failures).collect();
    Ok(lines?.iter().map(|line| format!("{line}\n")).collect())
}

/// All tables, as Markdown.
#[must_use]
pub fn markdown(all: &[Results]) -> String {
    let mut text = String::new();
    for results in all {
        let about = workloads::find(&results.workload).map_or("", |workload| workload.about);
        let machine = &results.machine;
        let versions = machine.versions.iter();
        let versions: Vec<_> = versions
            .map(|(name, version)| format!("{name} {version}"))
            .collect();
        let _ = writeln!(
            text,
            "### {}, read {}\n\n{about}. Median of {} repeats (least-greatest), ratio to `sm2`.\n\n\
             `{}`, {}, {} cores, Linux {}, load before: {}; {}.\n",
            results.workload,
            results.read.as_str(),
            results.repeats,
            results.command,
            machine.processor,
            machine.cores,
            machine.kernel,
            machine.load,
            versions.join(", "),
        );
        for (case, names) in columns(results) {
            for (at, row) in rows(results, &case, &names).iter().enumerate() {
                let _ = writeln!(text, "| {} |", row.join(" | "));
                if at == 0 {
                    let _ = writeln!(text, "|{}", " --- |".repeat(row.len()));
                }
            }
            text.push('\n');
        }
        for plot in crate::plot::names(results) {
            let _ = writeln!(text, "![{plot}](results/plots/{plot})");
        }
        text.push('\n');
    }
    text
}

/// Writes the tables between the two marker lines of a document.
///
/// # Errors
///
/// The file cannot be read or written, or lacks the marker lines.
pub fn rewrite(path: &Path, all: &[Results]) -> io::Result<()> {
    let text = fs::read_to_string(path)?;
    let text = between_marks(&text, &markdown(all)).ok_or_else(|| {
        let [begin, end] = MARKS;
        let reason = format!("{} needs the lines {begin} and {end}", path.display());
        io::Error::new(io::ErrorKind::InvalidData, reason)
    })?;
    fs::write(path, text)
}

fn between_marks(text: &str, tables: &str) -> Option<String> {
    let [begin, end] = MARKS;
    let (before, rest) = text.split_once(begin)?;
    let (_, after) = rest.split_once(end)?;
    Some(format!(
        "{before}{begin}\n\n{}\n\n{end}{after}",
        tables.trim_end()
    ))
}

#[cfg(test)]
mod tests;
