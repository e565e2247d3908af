//! Runs one engine: its programs, its results, and its verdict.

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Instant;

use sm2_verification::properties::{Engine, Extent, Outcome, outcomes};

use crate::plan::Plan;
use crate::process::{Ended, Interrupts};
use crate::screen::Screen;
use crate::verdict::Verdict;

/// The result of one engine.
#[derive(Debug)]
pub(crate) struct Ran {
    pub(crate) engine: Engine,
    pub(crate) verdict: Verdict,
    pub(crate) extent: Extent,
    pub(crate) outcomes: Vec<Outcome>,
    pub(crate) time_s: f64,
    pub(crate) log: PathBuf,
}

/// Runs the planned programs, with log and results in `folder`; `None` if interrupted.
pub(crate) fn run(
    plan: &Plan,
    root: &Path,
    folder: &Path,
    stop: &Interrupts,
    mut screen: Screen,
) -> io::Result<Option<Ran>> {
    let start = Instant::now();
    let engine = plan.engine();
    fs::create_dir_all(folder)?;
    let results = folder.join(format!("{engine}.tsv"));
    let log = folder.join(format!("{engine}.log"));
    fs::write(&results, "")?;
    fs::write(&log, "")?;
    let mut verdict = Verdict::Held;
    let steps = plan.steps(root, stop)?.unwrap_or_else(|why| {
        verdict.fail(why);
        Vec::new()
    });
    for step in &steps {
        match step.run(root, &log, &results, stop, &mut screen)? {
            Ended::Interrupted => return Ok(None),
            Ended::Well => {}
            Ended::Failed(status) => verdict.fail(format!("{status} of: {step}")),
            Ended::Skipped => {
                let why = last_lines(&log, 1);
                verdict.skip(why.trim_start_matches("skipped: ").to_owned());
            }
        }
    }
    let reported = outcomes(&fs::read_to_string(&results)?).unwrap_or_else(|error| {
        verdict.fail(error.to_string());
        Vec::new()
    });
    let mut extent = Extent::Partly;
    if let Verdict::Held = verdict {
        if let Some(why) = implausible(engine, &reported, steps.is_empty()) {
            verdict.fail(why);
        } else if plan.is_quick() {
            match plan.listed(root, stop)? {
                Ok(listed) => extent = Extent::RanQuick(listed),
                Err(why) => verdict.fail(why),
            }
        } else {
            extent = Extent::Ran;
        }
    }
    if stop.seen() {
        return Ok(None);
    }
    screen.ended(&verdict, reported.len());
    Ok(Some(Ran {
        engine,
        verdict,
        extent,
        outcomes: reported,
        time_s: start.elapsed().as_secs_f64(),
        log,
    }))
}

/// The reason why the results of an engine cannot be right although all its programs succeeded.
fn implausible(engine: Engine, reported: &[Outcome], nothing_to_run: bool) -> Option<String> {
    if reported.is_empty() && !nothing_to_run {
        return Some("it reported nothing".to_owned());
    }
    let mut names = BTreeSet::new();
    reported.iter().find_map(|it| {
        let (harness, of) = (&it.harness, it.engine);
        if of != engine {
            Some(format!("it reported `{harness}` as of {of}"))
        } else if !it.held {
            Some(format!("`{harness}` failed, and its program ended well"))
        } else if !names.insert(harness) {
            Some(format!("it reported `{harness}` twice"))
        } else {
            None
        }
    })
}

/// The last lines of a log.
pub(crate) fn last_lines(log: &Path, count: usize) -> String {
    let text = fs::read(log).unwrap_or_default();
    let text = String::from_utf8_lossy(&text);
    let lines: Vec<_> = text.lines().filter(|it| !it.trim().is_empty()).collect();
    lines[lines.len().saturating_sub(count)..].join("\n")
}
