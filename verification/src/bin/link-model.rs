//! `link-model [--quick] [--list] [SCOPE...]`: searches the scopes of one link, all of them if
//! none is named.
//!
//! Prints the figures of each scope, and the shortest path to a failure. Exit status: 0 if all
//! properties hold and the counts equal those in `link-model-counts.txt`, 1 if not, 2 for an unknown
//! scope. If `SM2_VERIFICATION_RESULTS` names a file, a line for each scope is added to it.

use std::env;
use std::io::{self, Write as _};
use std::process::ExitCode;

use sm2_verification::model::{
    explore,
    link::{COUNTS, LinkScope},
};

const USAGE: &str = "usage: link-model [--quick] [--list] [SCOPE...]
Searches the scopes of one link: those named, else all.
  --quick  only those that take seconds
  --list   only say which there are";
const LIMIT: usize = 10_000_000;

fn main() -> ExitCode {
    match run() {
        Ok(code) => code,
        Err(error) => {
            let _ = writeln!(io::stderr(), "link-model: {error}");
            ExitCode::from(2)
        }
    }
}

fn run() -> io::Result<ExitCode> {
    let (options, names): (Vec<_>, Vec<_>) =
        env::args().skip(1).partition(|it| it.starts_with('-'));
    let mut out = io::stdout().lock();
    let [mut quick, mut list] = [false; 2];
    for option in options {
        match option.as_str() {
            "--quick" => quick = true,
            "--list" => list = true,
            "--help" | "-h" => {
                writeln!(out, "{USAGE}")?;
                return Ok(ExitCode::SUCCESS);
            }
            _ => {
                writeln!(io::stderr(), "{USAGE}")?;
                return Ok(ExitCode::from(2));
            }
        }
    }
    let mut scopes = LinkScope::all();
    if let Some(unknown) = names.iter().find(|it| LinkScope::named(it).is_none()) {
        let all: Vec<_> = scopes.iter().map(|it| it.name).collect();
        let all = all.join(", ");
        writeln!(
            io::stderr(),
            "there is no scope {unknown}; there are: {all}"
        )?;
        return Ok(ExitCode::from(2));
    }
    scopes.retain(|it| names.is_empty() || names.iter().any(|name| name == it.name));
    scopes.retain(|it| it.quick || !quick);
    let mut held = true;
    for scope in scopes {
        if list {
            writeln!(out, "{}", scope.name)?;
            continue;
        }
        let report = explore(&scope, LIMIT);
        held &= COUNTS.tell(&mut out, scope.name, &report)?;
    }
    Ok(ExitCode::from(u8::from(!held)))
}
