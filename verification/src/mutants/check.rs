//! Builds a check in the copied workspace, and runs it.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io,
    path::{Path, PathBuf},
    process::{Command, ExitStatus, Stdio},
    thread,
    time::{Duration, Instant},
};

use serde::Deserialize;

use super::{Check, MutantsError};
use crate::test_targets::TestTarget;

/// A check that runs longer than this hangs. Without a fault, the slowest check takes a tenth of it.
const LIMIT: Duration = Duration::from_secs(120);
/// How often the runner polls a check.
const PAUSE: Duration = Duration::from_millis(5);
/// The seed of random operations, which makes them the same in each run.
const SEED: &str = "1";
/// The number of characters of a check's message that are shown.
const SAID_MAX: usize = 90;

/// A program that Cargo builds.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Target {
    pub(super) package: String,
    pub(super) unit: Unit,
}

/// The targets of a package.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Unit {
    /// The tests within the library.
    Lib,
    /// A program of tests.
    Test(String),
    /// A program.
    Program(String),
}

/// The paths of programs, by target.
pub(super) type Programs = BTreeMap<Target, PathBuf>;

/// The result of running a check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Ran {
    /// The check passed.
    Held,
    /// The check failed, with this message.
    Failed(String),
    /// The check found another fault than the expected one, with this message.
    Missed(String),
    /// The check exceeded its time limit.
    Hung,
}

/// Cargo, in the copied workspace.
#[derive(Debug)]
pub(super) struct Cargo {
    pub(super) root: PathBuf,
    /// The folder for the output of Cargo and of the checks.
    pub(super) work: PathBuf,
}

impl Cargo {
    /// Builds targets of one package: all of them tests, or all of them programs. The error is the
    /// message of the compiler.
    pub(super) fn build(
        &self,
        targets: &[Target],
    ) -> Result<Result<Programs, String>, MutantsError> {
        let program = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
        let mut command = self.command(Path::new(&program), &self.root);
        let tests = targets
            .iter()
            .any(|it| !matches!(it.unit, Unit::Program(_)));
        command.args(if tests {
            &["test", "--no-run"][..]
        } else {
            &["build"]
        });
        // With all cases of random tests, and with the tests that take long.
        command.args(tests.then_some("--features=slow"));
        command.args(["--locked", "--message-format=json"]);
        for target in targets {
            command.args(["--package", &target.package]);
            match &target.unit {
                Unit::Lib => command.arg("--lib"),
                Unit::Test(name) => command.args(["--test", name]),
                Unit::Program(name) => command.args(["--bin", name]),
            };
        }
        let built = command.output().map_err(MutantsError::start(program))?;
        let messages = String::from_utf8_lossy(&built.stdout);
        let messages = messages
            .lines()
            .filter_map(|it| serde_json::from_str(it).ok());
        let messages: Vec<Message> = messages.collect();
        if !built.status.success() {
            let errors = messages.iter().filter_map(Message::error).next();
            let stderr = || String::from_utf8_lossy(&built.stderr).into_owned();
            return Ok(Err(errors.unwrap_or_else(stderr)));
        }
        let mut programs = Programs::new();
        for target in targets {
            let built = messages.iter().find_map(|it| it.executable(&target.unit));
            let built = built.ok_or_else(|| MutantsError::NoExecutable(format!("{target:?}")))?;
            programs.insert(target.clone(), built);
        }
        Ok(Ok(programs))
    }

    /// Runs a check whose program is built.
    pub(super) fn run(&self, check: &Check, program: &Path) -> Result<Ran, MutantsError> {
        let folder = self.root.join(check.folder());
        let said = self.work.join("output.txt");
        let output = File::create(&said).map_err(MutantsError::file(&said))?;
        let errors = output.try_clone().map_err(MutantsError::file(&said))?;
        let mut command = self.command(program, &folder);
        command.env("CARGO_MANIFEST_DIR", &folder);
        command
            .args(check.arguments(&self.root)?)
            .stdin(Stdio::null());
        command.stdout(output).stderr(errors);
        let status = finish(&mut command).map_err(MutantsError::start(program))?;
        let said = fs::read(&said).map_err(MutantsError::file(&said))?;
        Ok(check.judge(status, &String::from_utf8_lossy(&said)))
    }

    /// A command that does not depend on files or variables outside the copy.
    fn command(&self, program: &Path, folder: &Path) -> Command {
        let mut command = Command::new(program);
        command
            .current_dir(folder)
            .env("CARGO_TARGET_DIR", self.work.join("target"))
            .env("CARGO_INCREMENTAL", "1")
            .env("CARGO_PROFILE_DEV_DEBUG", "0")
            .env("CARGO_TERM_COLOR", "never")
            // A mutant may cause warnings about unused items.
            .env("RUSTFLAGS", "--cap-lints=warn")
            .env_remove("CARGO_ENCODED_RUSTFLAGS")
            .env_remove("SM2_VERIFICATION_RESULTS")
            .env_remove("PROPTEST_CASES")
            .env("PROPTEST_RNG_SEED", SEED)
            .env("PROPTEST_MAX_SHRINK_ITERS", "0")
            .env("RUST_BACKTRACE", "0");
        command
    }
}

/// Waits for a process; `None` if it exceeds the time limit.
fn finish(command: &mut Command) -> io::Result<Option<ExitStatus>> {
    let began = Instant::now();
    let mut process = command.spawn()?;
    loop {
        if let Some(status) = process.try_wait()? {
            return Ok(Some(status));
        }
        if began.elapsed() > LIMIT {
            process.kill()?;
            process.wait()?;
            return Ok(None);
        }
        thread::sleep(PAUSE);
    }
}

impl Check {
    /// The target to build for the check.
    pub(super) fn target(&self, root: &Path) -> Result<Target, MutantsError> {
        let (package, unit) = match self {
            Self::Harness { .. } => ("sm2-proto", Unit::Lib),
            Self::Model { .. } => ("sm2-verification", Unit::Program("model".to_owned())),
            Self::Test { package, .. } => {
                let unit = match self.program(root)? {
                    Some(TestTarget { name, .. }) => Unit::Test(name),
                    None => Unit::Lib,
                };
                (package.as_str(), unit)
            }
        };
        Ok(Target {
            package: package.to_owned(),
            unit,
        })
    }

    /// The program with the file of the test; `None` if the check is not a test of such a file.
    fn program(&self, root: &Path) -> Result<Option<TestTarget>, MutantsError> {
        match self {
            Self::Test { target, .. } if target != "lib" => {
                let package = root.join(self.folder());
                let found = TestTarget::of(&package, target);
                found.map(Some).map_err(MutantsError::file(&package))
            }
            _ => Ok(None),
        }
    }

    fn arguments(&self, root: &Path) -> Result<Vec<String>, MutantsError> {
        Ok(match self {
            Self::Harness { name } => {
                let path = name.split_once("::").map_or(name.as_str(), |it| it.1);
                let (module, function) = path.rsplit_once("::").unwrap_or(("", path));
                vec!["--exact".into(), format!("{module}::explored::{function}")]
            }
            Self::Model { scope, .. } => vec![scope.clone()],
            Self::Test { test, .. } => {
                let prefix = self.program(root)?.map(|it| it.prefix);
                vec!["--exact".into(), prefix.unwrap_or_default() + test]
            }
        })
    }

    fn judge(&self, status: Option<ExitStatus>, said: &str) -> Ran {
        let Some(status) = status else {
            return Ran::Hung;
        };
        match self {
            Self::Model { property, .. } => {
                let found = said.lines().map(str::trim);
                let found = found
                    .clone()
                    .find(|it| it.starts_with(&format!("{property}: ")));
                match (found, status.success()) {
                    (Some(found), false) => Ran::Failed(shortened(found)),
                    (_, true) => Ran::Held,
                    // The line below the counts has the finding.
                    (None, false) => Ran::Missed(shortened(said.lines().nth(1).unwrap_or(said))),
                }
            }
            Self::Harness { .. } | Self::Test { .. } => {
                if !said.contains("running 1 test") {
                    return Ran::Missed("there is no such test".to_owned());
                }
                match status.success() {
                    true => Ran::Held,
                    false => Ran::Failed(reason(said)),
                }
            }
        }
    }
}

/// The message of a failed test: the line below the first *panicked at*.
fn reason(said: &str) -> String {
    let mut lines = said.lines();
    let panicked = lines.find(|it| it.contains("panicked at"));
    let below = lines.find(|it| !it.trim().is_empty());
    shortened(panicked.and(below).unwrap_or("it ended before its time"))
}

fn shortened(text: &str) -> String {
    let line = text.trim().lines().next().unwrap_or_default();
    match line.char_indices().nth(SAID_MAX) {
        Some((end, _)) => format!("{}…", &line[..end]),
        None => line.to_owned(),
    }
}

/// The used parts of Cargo's messages with `--message-format=json`.
#[derive(Debug, Deserialize)]
struct Message {
    target: Option<MessageTarget>,
    profile: Option<MessageProfile>,
    executable: Option<PathBuf>,
    message: Option<Diagnostic>,
}

#[derive(Debug, Deserialize)]
struct MessageTarget {
    name: String,
    kind: Vec<String>,
}

#[derive(Debug, Deserialize)]
struct MessageProfile {
    test: bool,
}

#[derive(Debug, Deserialize)]
struct Diagnostic {
    level: String,
    rendered: Option<String>,
}

impl Message {
    /// The program of this unit, if the message is about it.
    fn executable(&self, unit: &Unit) -> Option<PathBuf> {
        let target = self.target.as_ref()?;
        let is_test = self.profile.as_ref()?.test;
        let is_it =
            |kind: &str, name: &str| target.kind.iter().any(|it| it == kind) && target.name == name;
        let found = match unit {
            Unit::Lib => is_test && !target.kind.iter().any(|it| it == "test" || it == "bin"),
            Unit::Test(name) => is_test && is_it("test", name),
            Unit::Program(name) => !is_test && is_it("bin", name),
        };
        self.executable.clone().filter(|_| found)
    }

    fn error(&self) -> Option<String> {
        let message = self.message.as_ref()?;
        (message.level == "error").then(|| message.rendered.clone())?
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::process::ExitStatusExt;

    use super::*;

    fn ended(code: i32) -> Option<ExitStatus> {
        Some(ExitStatus::from_raw(code << 8))
    }

    #[test]
    fn a_test_that_is_not_there_is_no_kill() {
        let check = Check::Harness {
            name: "sm2_proto::a::proofs::one".to_owned(),
        };
        assert_eq!(
            check.arguments(Path::new("")).expect("arguments")[1],
            "a::proofs::explored::one"
        );
        let none = check.judge(ended(0), "running 0 tests\ntest result: ok. 0 passed");
        assert!(matches!(none, Ran::Missed(_)), "{none:?}");
        assert_eq!(check.judge(ended(0), "running 1 test\n"), Ran::Held);
        let said = "running 1 test\nthread 'x' panicked at a.rs:1:1:\nit bites\nmore";
        assert_eq!(
            check.judge(ended(101), said),
            Ran::Failed("it bites".to_owned())
        );
        assert_eq!(check.judge(None, said), Ran::Hung);
    }

    #[test]
    fn other_counts_of_the_model_are_no_kill() {
        let check = Check::Model {
            scope: "cold-2x2".to_owned(),
            property: "Converges".to_owned(),
        };
        let counts = "cold-2x2: 1 states\n  model-counts.txt does not have: cold-2x2 1";
        assert!(matches!(check.judge(ended(1), counts), Ran::Missed(_)));
        let other = "cold-2x2: 1 states\n  OneFarewell: twice";
        assert!(matches!(check.judge(ended(1), other), Ran::Missed(_)));
        let found = "cold-2x2: 1 states\n  Converges: not linked\n    1 declares";
        let said = "Converges: not linked".to_owned();
        assert_eq!(check.judge(ended(1), found), Ran::Failed(said));
        assert_eq!(check.judge(ended(0), "cold-2x2: 1 states"), Ran::Held);
    }
}
