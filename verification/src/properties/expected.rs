//! The coverage that a passed check must have at least.

use std::path::Path;
use std::{fs, io};

use super::{Check, Engine};

/// The least number of times that a fuzz target runs.
const FUZZED_LEAST: u64 = 1_000;

/// The expectation that the figures of a passed check do not meet, if there is one. `tests` is the number of tests that
/// the source of a file of tests has.
pub(super) fn unmet(check: &Check, covered: &str, tests: Option<u64>) -> Option<String> {
    let strength = match check.engine {
        Engine::Angr => Some("Symbolic"),
        _ => check.strength.as_deref(),
    };
    let first = covered.split(',').next();
    if let Some(strength) = strength.filter(|it| first != Some(it)) {
        return Some(strength.to_owned());
    }
    let (least, unit) = match check.engine {
        Engine::StandIn | Engine::Angr => {
            let number = |word: &str| {
                let mut parts = covered.split([',', ';']).map(str::trim);
                let part = parts.find_map(|it| it.strip_suffix(word));
                part.and_then(|it| it.parse::<u64>().ok())
            };
            let is_met = number(" paths") > number(" rejected").or(Some(0));
            return (!is_met).then(|| "paths that are not rejected".to_owned());
        }
        Engine::Test | Engine::Proptest | Engine::Vector => (tests?, "tests"),
        Engine::LibFuzzer => (FUZZED_LEAST, "executions"),
        _ => return None,
    };
    let is_met = counted(covered).is_some_and(|it| it >= least);
    (!is_met).then(|| format!("{least} {unit} or more"))
}

/// The number at the beginning of figures; that of a noisy one is behind `~`.
fn counted(covered: &str) -> Option<u64> {
    let text = covered.strip_prefix('~').unwrap_or(covered);
    text.split_once(' ')?.0.parse().ok()
}

/// The number of tests of a source, without those that may be ignored.
#[must_use]
pub fn tests_in(source: &str) -> u64 {
    let (mut tests, mut is_test, mut is_ignored) = (0, false, false);
    let lines = source.lines().map(str::trim_start);
    for line in lines.filter(|it| !it.starts_with("//")) {
        if line.starts_with("#[test]") {
            is_test = true;
        } else if line.starts_with("ignore") || line.starts_with("#[") && line.contains("ignore") {
            is_ignored = true;
        } else if line.contains("fn ") {
            tests += u64::from(is_test && !is_ignored);
            (is_test, is_ignored) = (false, false);
        }
    }
    tests
}

/// The number of tests of a source and of its modules.
///
/// # Errors
/// A file or folder cannot be read.
pub fn tests_of(file: &Path) -> io::Result<u64> {
    let mut tests = tests_in(&fs::read_to_string(file)?);
    let modules = file.with_extension("");
    if modules.is_dir() {
        for entry in fs::read_dir(modules)? {
            let path = entry?.path();
            if path.extension().is_some_and(|it| it == "rs") {
                tests += tests_of(&path)?;
            }
        }
    }
    Ok(tests)
}
