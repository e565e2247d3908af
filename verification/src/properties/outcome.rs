//! The reports of the engines: one line for each check, with tabs between the fields.

use super::Engine;

/// The outcome of one check.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The engine that ran it.
    pub engine: Engine,
    /// Its name, the one in the column *harness*.
    pub harness: String,
    /// True if the check passed.
    pub held: bool,
    /// The duration.
    pub time_s: f64,
    /// The coverage.
    pub covered: String,
}

/// An invalid line.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "not a result: `{0}`; wanted: engine, check, `ok` or `FAILED`, seconds, covered, with tabs between"
)]
pub struct UnreadableOutcome(pub String);

/// Reads the lines of a results file.
///
/// # Errors
/// A line is invalid.
pub fn outcomes(text: &str) -> Result<Vec<Outcome>, UnreadableOutcome> {
    let read = |line: &str| outcome(line).ok_or_else(|| UnreadableOutcome(line.to_owned()));
    text.lines().map(read).collect()
}

fn outcome(line: &str) -> Option<Outcome> {
    let fields: Vec<_> = line.split('\t').collect();
    let [engine, harness, verdict, seconds, covered] = fields[..] else {
        return None;
    };
    let held = match verdict {
        "ok" => true,
        "FAILED" => false,
        _ => return None,
    };
    Some(Outcome {
        engine: Engine::named(engine)?,
        harness: harness.to_owned(),
        held,
        time_s: seconds.parse().ok()?,
        covered: covered.trim().to_owned(),
    })
}
