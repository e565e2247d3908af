//! `check`: runs every check that this machine can run, and compares the results with PROPERTIES.md.
//!
//! Each engine runs by itself, with its output in a log. Its results go into one table at the end, and
//! are compared with PROPERTIES.md and the comments of the checks.
//!
//! Exit status:
//!
//! - 0: all checks passed, and PROPERTIES.md agrees;
//! - 1: a check failed, PROPERTIES.md disagrees, or nothing was run;
//! - 2: the run could not start;
//! - 77: this machine can run none of the selected checks;
//! - 130: interrupted; all started processes have ended.

mod args;
mod plan;
mod process;
mod run;
mod screen;
mod step;
mod table;
mod tested;
mod verdict;

use std::collections::BTreeSet;
use std::env;
use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

use sm2_verification::clauses::{self, Level};
use sm2_verification::properties::{
    Engine, Gap, GapKind, Listed, Register, Run, RunResults, figures_page, summary, tests_of,
};

use self::args::{Action, Args};
use self::plan::{Plan, target};
use self::process::Interrupts;
use self::run::Ran;
use self::screen::Screen;
use self::verdict::Verdict;

/// Exit status if a check failed, if rows and run disagree, or if nothing was run.
const FAILED: u8 = 1;
/// Exit status if this machine can run none of the selected checks.
const SKIPPED: u8 = 77;
/// The number of lines of a failed engine's log that are shown.
const LAST_LINES: usize = 25;
/// Exit status of a program that SIGINT ended, as shells report it.
const INTERRUPTED: u8 = 130;

fn main() -> ExitCode {
    let args = match Args::parse(env::args().skip(1)) {
        Ok(args) => args,
        Err(status) => return status,
    };
    match Check::new(args).and_then(Check::run) {
        Ok(status) => status,
        Err(error) => {
            let _ = writeln!(io::stderr().lock(), "check: {error}");
            ExitCode::from(2)
        }
    }
}

struct Check {
    args: Args,
    root: PathBuf,
    register: Register,
    broken: Vec<Gap>,
    results: RunResults,
    runs: Vec<Ran>,
}

impl Check {
    fn new(args: Args) -> io::Result<Self> {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("..")
            .canonicalize()?;
        let text = fs::read_to_string(root.join("verification/PROPERTIES.md"))?;
        let (register, broken) = Register::parse(&text, &Listed::load(&root)?);
        Ok(Self {
            args,
            root,
            register,
            broken,
            results: RunResults::default(),
            runs: Vec::new(),
        })
    }

    fn run(mut self) -> io::Result<ExitCode> {
        if self.args.action == Action::PrintTable {
            return say(&summary(&self.register)).map(|()| ExitCode::SUCCESS);
        }
        if let Some(unknown) = self.select() {
            say(&format!(
                "no engine, property or harness is called {unknown}"
            ))?;
            return Ok(ExitCode::from(2));
        }
        let start = Instant::now();
        let interrupts = Interrupts::watch()?;
        let engines = self.engines();
        for (index, engine) in engines.iter().enumerate() {
            let screen = Screen::new(*engine, index + 1, engines.len());
            if !self.engine(*engine, &interrupts, screen)? {
                say(&table::render(&self.register, &self.runs))?;
                say(&format!("interrupted while {engine} ran"))?;
                return Ok(ExitCode::from(INTERRUPTED));
            }
        }
        say(&table::render(&self.register, &self.runs))?;
        self.count_tests()?;
        let page = target(&self.root).join("verification/figures.md");
        fs::write(&page, figures_page(&self.register, &self.results.outcomes))?;
        let gaps = self.gaps()?;
        for gap in &gaps {
            say(&format!("GAP {gap}"))?;
        }
        self.summary(gaps.len(), start)
    }

    /// Selects the rows; returns a word that selects nothing, if there is one.
    fn select(&mut self) -> Option<String> {
        let mut chosen = BTreeSet::new();
        for word in &self.args.only {
            let rows = self.register.checks().iter().filter(|it| {
                it.engine.word() == word || it.harness == *word || it.shows.contains(word)
            });
            let rows: Vec<_> = rows.map(|it| (it.engine, it.harness.clone())).collect();
            // An engine may have no rows yet.
            if rows.is_empty() && Engine::named(word).is_none() {
                return Some(word.clone());
            }
            chosen.extend(rows);
        }
        self.results.only = (!self.args.only.is_empty()).then_some(chosen);
        None
    }

    /// True if all checks of an engine are selected.
    fn whole(&self, engine: Engine) -> bool {
        self.args.only.is_empty() || self.args.only.iter().any(|it| it == engine.word())
    }

    /// The engines to run, in their order.
    fn engines(&self) -> Vec<Engine> {
        let asked = |engine: &Engine| {
            let rows = self.results.only.iter().flatten();
            self.whole(*engine) || rows.into_iter().any(|(it, _)| it == engine)
        };
        Engine::ALL.into_iter().filter(asked).collect()
    }

    /// Runs one engine; false if that was interrupted.
    fn engine(&mut self, engine: Engine, stop: &Interrupts, screen: Screen) -> io::Result<bool> {
        let asked = |harness: &String| {
            let key = (engine, harness.clone());
            self.whole(engine) || self.results.only.iter().any(|it| it.contains(&key))
        };
        let rows = self.register.of(engine);
        let rows = rows.map(|it| (it.harness.clone(), it.run == Run::Quick));
        let rows = rows.filter(|(harness, _)| asked(harness)).collect();
        let plan = Plan::new(engine, self.args.quick, self.whole(engine), rows);
        let folder = target(&self.root).join("verification");
        let Some(ran) = run::run(&plan, &self.root, &folder, stop, screen)? else {
            return Ok(false);
        };
        if let Verdict::Failed { .. } = ran.verdict {
            let lines = run::last_lines(&ran.log, LAST_LINES);
            say(&format!("{lines}\n--- the end of {}\n", ran.log.display()))?;
        }
        self.results.engines.insert(engine, ran.extent.clone());
        self.results.outcomes.extend(ran.outcomes.iter().cloned());
        self.runs.push(ran);
        Ok(true)
    }

    /// Counts the tests of the sources whose tests ran.
    fn count_tests(&mut self) -> io::Result<()> {
        for outcome in &self.results.outcomes {
            let is_of_tests = matches!(
                outcome.engine,
                Engine::Test | Engine::Proptest | Engine::Vector
            );
            let file = self.root.join(&outcome.harness);
            // A single test is `FILE::NAME`.
            if is_of_tests && file.is_file() {
                let tests = tests_of(&file)?;
                self.results.tests.insert(outcome.harness.clone(), tests);
            }
        }
        Ok(())
    }

    fn gaps(&mut self) -> io::Result<Vec<Gap>> {
        let mut gaps = std::mem::take(&mut self.broken);
        gaps.extend(self.unknown_clauses()?);
        gaps.extend(self.results.gaps(&self.register));
        Ok(gaps)
    }

    fn unknown_clauses(&self) -> io::Result<Vec<Gap>> {
        let spec = clauses::check(&self.root).map_err(io::Error::other)?;
        let in_force = |level| matches!(level, Level::Must | Level::Should | Level::May);
        let mut gaps = Vec::new();
        for property in self.register.properties() {
            for clause in &property.clauses {
                let found = spec.clauses().get(clause);
                if !found.is_some_and(|it| in_force(it.level)) {
                    let kind = GapKind::UnknownClause(clause.to_string());
                    let line = Some(property.line);
                    gaps.push(Gap { line, kind });
                }
            }
        }
        Ok(gaps)
    }

    /// Prints the last line, and returns the exit status.
    fn summary(&self, gaps: usize, start: Instant) -> io::Result<ExitCode> {
        let checks = self.results.outcomes.len();
        let failed = self.results.outcomes.iter().filter(|it| !it.held).count();
        let ended =
            |is: fn(&Verdict) -> bool| self.runs.iter().filter(|it| is(&it.verdict)).count();
        let bad = ended(|it| matches!(it, Verdict::Failed { .. }));
        let skipped = ended(|it| matches!(it, Verdict::Skipped { .. }));
        let engines = self.runs.len();
        let time_s = start.elapsed().as_secs();
        say(&format!(
            "{checks} checks of {engines} engines in {time_s} s: {failed} checks and {bad} engines \
             failed, {skipped} engines skipped, {gaps} gaps"
        ))?;
        let well = failed == 0 && bad == 0 && gaps == 0;
        Ok(ExitCode::from(match (well, checks, skipped) {
            (true, 0, 0) => FAILED,
            (true, 0, _) => SKIPPED,
            (true, ..) => 0,
            (false, ..) => FAILED,
        }))
    }
}

/// Prints a text; a closed pipe, as with `head`, ends the run.
fn say(text: &str) -> io::Result<()> {
    writeln!(io::stdout().lock(), "{text}")
}
