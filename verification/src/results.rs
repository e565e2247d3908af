//! One line of results for each check, for the program that collects all of them.

use std::{
    env,
    fs::OpenOptions,
    io::{self, Write as _},
    time::Duration,
};

/// Names the file to append to.
const FILE: &str = "SM2_VERIFICATION_RESULTS";

/// The coverage of a check, as a line of the results.
#[must_use]
pub fn line(engine: &str, check: &str, holds: bool, took: Duration, covered: &str) -> String {
    let verdict = if holds { "ok" } else { "FAILED" };
    let seconds = took.as_secs_f64();
    format!("{engine}\t{check}\t{verdict}\t{seconds:.1}\t{covered}\n")
}

/// Adds a [`line()`] to that file, if it is named.
///
/// # Errors
///
/// It cannot be written.
pub fn append(line: &str) -> io::Result<()> {
    let Some(file) = env::var_os(FILE) else {
        return Ok(());
    };
    let mut file = OpenOptions::new().create(true).append(true).open(file)?;
    file.write_all(line.as_bytes())
}
