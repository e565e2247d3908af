//! `clauses [--list] [ROOT]`: compares SPEC.md with its citations.
//!
//! Prints the counts, then each gap. Exit status: 0 without gaps, 1 with gaps, 2 if the check cannot
//! run.

use std::env;
use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::path::PathBuf;
use std::process::ExitCode;

use sm2_verification::{
    clauses::{self, Report},
    workspace,
};

const USAGE: &str = "usage: clauses [--list] [ROOT]
Compares SPEC.md below ROOT (default: the workspace) with the code and checks that cite it.
  --list  also print each clause with the places that cite it";

fn main() -> ExitCode {
    let mut list = false;
    let mut root = None;
    for arg in env::args_os().skip(1) {
        match arg.to_str() {
            Some("--list") => list = true,
            Some("--help" | "-h") => return print(USAGE, ExitCode::SUCCESS),
            _ if root.is_none() && !arg.to_string_lossy().starts_with('-') => {
                root = Some(PathBuf::from(arg));
            }
            _ => return refuse(USAGE),
        }
    }
    match clauses::check(&root.unwrap_or_else(workspace)) {
        Ok(report) if report.gaps().is_empty() => print(&text(&report, list), ExitCode::SUCCESS),
        Ok(report) => print(&text(&report, list), ExitCode::FAILURE),
        Err(error) => refuse(&format!("clauses: {error}")),
    }
}

fn text(report: &Report, list: bool) -> String {
    let mut text = String::new();
    if list {
        text.push_str(&table(report));
    }
    text.push_str(&report.summary());
    for gap in report.gaps() {
        let _ = write!(text, "\nGAP {gap}");
    }
    text
}

/// A line for each clause, followed by a line for each citation.
fn table(report: &Report) -> String {
    let mut text = String::new();
    for (id, traced) in report.clauses() {
        let _ = writeln!(text, "{id} {:<7} {}", traced.level, traced.at);
        for line in &traced.code {
            let _ = writeln!(text, "    code    {line}");
        }
        for (kind, line) in &traced.checks {
            let _ = writeln!(text, "    {kind:<7} {line}");
        }
    }
    text
}

/// Prints a text; a closed pipe, as with `head`, is not a failure.
fn print(text: &str, status: ExitCode) -> ExitCode {
    let _ = writeln!(io::stdout().lock(), "{text}");
    status
}

fn refuse(text: &str) -> ExitCode {
    let _ = writeln!(io::stderr().lock(), "{text}");
    ExitCode::from(2)
}
