//! `model [SCOPE...]`: searches the scopes, all of them if none is named.
//!
//! Prints the figures of each, and the shortest way to a failure. Status 0: all held, and the
//! counts are those of `model-counts.txt`; 1: not so; 2: there is no such scope.

use std::env;
use std::io::{self, Write as _};
use std::process::ExitCode;

use sm2_verification::model::{Report, Scope, explore};

/// What was counted before.
const COUNTS: &str = include_str!("../../model-counts.txt");
const LIMIT: usize = 40_000_000;

fn main() -> ExitCode {
    run().unwrap_or(ExitCode::from(2))
}

fn run() -> io::Result<ExitCode> {
    let names: Vec<_> = env::args().skip(1).collect();
    let mut out = io::stdout().lock();
    let mut scopes = Scope::all();
    if let Some(unknown) = names.iter().find(|it| Scope::named(it).is_none()) {
        writeln!(out, "there is no scope {unknown}; there are:")?;
        for scope in scopes {
            writeln!(out, "  {}", scope.name)?;
        }
        return Ok(ExitCode::from(2));
    }
    scopes.retain(|it| names.is_empty() || names.iter().any(|name| name == it.name));
    let mut held = true;
    for scope in scopes {
        let report = explore(&scope, LIMIT);
        held &= tell(&mut out, &scope, &report)?;
    }
    Ok(ExitCode::from(u8::from(!held)))
}

fn tell(out: &mut impl io::Write, scope: &Scope, report: &Report) -> io::Result<bool> {
    let counts = format!(
        "{} {} {} {} {}",
        scope.name, report.states, report.transitions, report.depth, report.quiet
    );
    let (name, time) = (scope.name, report.time.as_secs_f64());
    writeln!(
        out,
        "{name}: {} states, {} transitions, depth {}, {} quiet, {time:.1} s",
        report.states, report.transitions, report.depth, report.quiet
    )?;
    if report.cut_short {
        writeln!(out, "  stopped at {LIMIT} states")?;
    }
    if let Some(found) = &report.failure {
        writeln!(out, "  {}", found.failure)?;
        for (step, action) in (1..).zip(&found.steps) {
            writeln!(out, "  {step:3} {action}")?;
        }
        return Ok(false);
    }
    let as_before = COUNTS.lines().any(|line| line == counts);
    if !as_before {
        writeln!(out, "  model-counts.txt does not have: {counts}")?;
    }
    Ok(as_before && !report.cut_short)
}
