//! One program of an engine, and the source of its results.

use std::ffi::OsString;
use std::fmt;
use std::fs::{self, OpenOptions};
use std::io::{self, Write as _};
use std::path::Path;
use std::time::Instant;

use sm2_verification::properties::Engine;

use crate::process::{self, Ended, Interrupts};
use crate::screen::Screen;
use crate::tested::passed;

/// The variable with the file that runners append their results to.
const RESULTS: &str = "SM2_VERIFICATION_RESULTS";

/// One program.
pub(crate) struct Step {
    words: Vec<OsString>,
    reports: Reports,
}

/// The source of a program's results.
pub(crate) enum Reports {
    /// The program writes them.
    Itself,
    /// The program is one check; its last line has its coverage behind this text.
    After(Engine, &'static str),
    /// The program is one check without output.
    Built(Engine),
    /// The program is a test target.
    Tests(Engine, String),
    /// There is no program: an earlier run has passed this number of tests.
    Passed(Engine, String, usize),
}

impl Step {
    pub(crate) fn new(line: &str, reports: Reports) -> Self {
        Self {
            words: line.split(' ').map(OsString::from).collect(),
            reports,
        }
    }

    /// Adds words to its line.
    pub(crate) fn with(mut self, words: impl IntoIterator<Item = impl Into<OsString>>) -> Self {
        self.words.extend(words.into_iter().map(Into::into));
        self
    }

    /// Runs it with its standard output in the file `output`.
    pub(crate) fn print(&self, root: &Path, output: &Path, stop: &Interrupts) -> io::Result<Ended> {
        fs::write(output, "")?;
        process::run(&self.words, &environment(None), root, output, stop, || {})
    }

    /// Runs it, and appends its result if the program does not do that itself.
    pub(crate) fn run(
        &self,
        root: &Path,
        log: &Path,
        results: &Path,
        stop: &Interrupts,
        screen: &mut Screen,
    ) -> io::Result<Ended> {
        if let Reports::Passed(engine, name, tests) = &self.reports {
            append(
                results,
                &format!("{engine}\t{name}\tok\t0.0\t{tests} tests\n"),
            )?;
            return Ok(Ended::Well);
        }
        let before = fs::metadata(log)?.len();
        let start = Instant::now();
        let turn = || screen.progress(|| process::lines(results));
        let ended = process::run(
            &self.words,
            &environment(Some(results)),
            root,
            log,
            stop,
            turn,
        )?;
        if matches!(ended, Ended::Interrupted | Ended::Skipped) {
            return Ok(ended);
        }
        let text = fs::read(log)?;
        let text = String::from_utf8_lossy(
            text.get(usize::try_from(before).unwrap_or(0)..)
                .unwrap_or_default(),
        );
        let (engine, harness, covered) = match &self.reports {
            Reports::Itself | Reports::Passed(..) => return Ok(ended),
            Reports::After(engine, words) => {
                let covered = text.lines().find_map(|it| it.split_once(words));
                (
                    engine,
                    engine.word(),
                    covered.map(|(_, rest)| rest.to_owned()),
                )
            }
            Reports::Built(engine) => (engine, engine.word(), Some("linked".to_owned())),
            Reports::Tests(engine, name) => (engine, name.as_str(), passed_text(&text)),
        };
        let held = ended == Ended::Well && covered.is_some();
        let verdict = if held { "ok" } else { "FAILED" };
        let covered = covered.unwrap_or_else(|| "nothing".to_owned());
        // Only the time of the tests themselves, without that of their build.
        let time_s = finished(&text).unwrap_or_else(|| start.elapsed().as_secs_f64());
        append(
            results,
            &format!("{engine}\t{harness}\t{verdict}\t{time_s:.1}\t{covered}\n"),
        )?;
        Ok(ended)
    }
}

fn append(results: &Path, line: &str) -> io::Result<()> {
    let mut file = OpenOptions::new().append(true).open(results)?;
    file.write_all(line.as_bytes())
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words: Vec<_> = self.words.iter().map(|it| it.to_string_lossy()).collect();
        f.write_str(&words.join(" "))
    }
}

/// The number of passed tests, as text; `None` if there is none.
fn passed_text(log: &str) -> Option<String> {
    let passed: usize = log.lines().filter_map(passed).sum();
    (passed > 0).then(|| format!("{passed} tests"))
}

fn environment(results: Option<&Path>) -> Vec<(&'static str, OsString)> {
    let mut all = vec![("CARGO_TERM_COLOR", OsString::from("never"))];
    all.extend(results.map(|it| (RESULTS, it.into())));
    all
}

/// The duration of the tests, if any ran.
fn finished(log: &str) -> Option<f64> {
    let time_s = |line: &str| {
        let (_, rest) = line.split_once("; finished in ")?;
        rest.trim_end_matches('s').parse::<f64>().ok()
    };
    let times: Vec<_> = log.lines().filter_map(time_s).collect();
    (!times.is_empty()).then(|| times.iter().sum())
}
