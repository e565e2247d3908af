//! The commands that run each engine.

use std::collections::{BTreeMap, BTreeSet};
use std::env;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use sm2_verification::{properties::Engine, test_targets::TestTarget};

use crate::process::{Ended, Interrupts};
use crate::step::{Reports, Step};
use crate::tested::Tested;

const FUZZ_SECONDS: &str = "SM2_CI_FUZZ_SECONDS";
/// `1` in `.ci/full`, which builds all tests with the feature `slow`.
const FULL: &str = "SM2_CI_FULL";

/// The programs of engines that take names, or `--quick`, or `--list`.
fn programs(engine: Engine) -> io::Result<Vec<String>> {
    Ok(match engine {
        Engine::Model => ["model", "link-model", "lockstep-model"]
            .map(|it| {
                format!("cargo run -q --locked -p sm2-verification --profile model --bin {it} --")
            })
            .into(),
        Engine::Angr => vec!["verification/symbolic/run".to_owned()],
        Engine::Mutants => vec![sibling("mutants")?],
        _ => Vec::new(),
    })
}

/// The path of a program that Cargo has built together with this one.
fn sibling(name: &str) -> io::Result<String> {
    let path = env::current_exe()?.with_file_name(name);
    Ok(path.display().to_string())
}

/// `cargo test` as the step `test` of `.ci/run` calls it, so that nothing is built again.
fn cargo_test(is_slow: bool) -> String {
    let is_full = env::var_os(FULL).is_some_and(|it| it == "1");
    let features = if is_slow || is_full {
        " --features slow"
    } else {
        ""
    };
    format!("cargo test --locked --workspace{features}")
}

/// The commands to run for an engine.
pub(crate) struct Plan {
    engine: Engine,
    /// True if the engine is limited to its quick bounds.
    quick: bool,
    /// True if all of its checks are selected, not only those of `rows`.
    whole: bool,
    /// The selected rows; true for quick ones.
    rows: BTreeMap<String, bool>,
}

/// Names of checks, or the reason why they cannot be listed.
type Listed = Result<BTreeSet<String>, String>;

impl Plan {
    pub(crate) fn new(
        engine: Engine,
        quick: bool,
        whole: bool,
        rows: BTreeMap<String, bool>,
    ) -> Self {
        Self {
            engine,
            quick,
            whole,
            rows,
        }
    }

    pub(crate) const fn engine(&self) -> Engine {
        self.engine
    }

    pub(crate) const fn is_quick(&self) -> bool {
        self.quick
    }

    /// The programs to run, one after the other; none if this is a quick run and all selected rows
    /// belong to full runs.
    pub(crate) fn steps(
        &self,
        root: &Path,
        stop: &Interrupts,
    ) -> io::Result<Result<Vec<Step>, String>> {
        if !self.rows.is_empty() && self.wanted().next().is_none() {
            return Ok(Ok(Vec::new()));
        }
        let itself = |line: &str| vec![Step::new(line, Reports::Itself)];
        let engine = self.engine;
        Ok(Ok(match engine {
            Engine::Clauses => vec![Step::new(
                &sibling("clauses")?,
                Reports::After(engine, "check links; "),
            )],
            Engine::NoStd => {
                let line = "cargo build --release --locked --manifest-path verification/no-std/Cargo.toml --target-dir";
                vec![Step::new(line, Reports::Built(engine)).with([target(root).join("no-std")])]
            }
            Engine::StandIn => itself(&format!("{} --lib explored", cargo_test(false))),
            Engine::Test | Engine::Proptest | Engine::Vector => self.tests(root)?,
            Engine::Loom => itself("verification/loom"),
            Engine::LibFuzzer => {
                let seconds = if self.quick { "10" } else { "60" };
                let seconds = env::var(FUZZ_SECONDS).unwrap_or_else(|_| seconds.to_owned());
                let step = Step::new(&format!(".ci/fuzz {seconds}"), Reports::Itself);
                let names = self.wanted().filter(|_| self.quick || !self.whole);
                vec![step.with(names)]
            }
            Engine::Kani => itself("verification/kani"),
            Engine::Model | Engine::Angr | Engine::Mutants => return self.listing(root, stop),
        }))
    }

    /// The programs that list their checks, each with its selected checks.
    fn listing(&self, root: &Path, stop: &Interrupts) -> io::Result<Result<Vec<Step>, String>> {
        let mut steps = Vec::new();
        for program in programs(self.engine)? {
            let step = Step::new(&program, Reports::Itself);
            if self.whole {
                let quick = self.quick.then_some("--quick");
                steps.push(step.with(quick));
                continue;
            }
            let listed = match self.list(&program, root, stop)? {
                Ok(listed) => listed,
                Err(why) => return Ok(Err(why)),
            };
            let names: Vec<_> = self.wanted().filter(|it| listed.contains(*it)).collect();
            if !names.is_empty() {
                steps.push(step.with(names));
            }
        }
        Ok(Ok(steps))
    }

    /// The rows that this run must run.
    fn wanted(&self) -> impl Iterator<Item = &String> {
        let wanted = |(_, quick): &(&String, &bool)| **quick || !self.quick;
        self.rows.iter().filter(wanted).map(|(name, _)| name)
    }

    /// The test targets. A target that an earlier run has passed does not run again.
    fn tests(&self, root: &Path) -> io::Result<Vec<Step>> {
        let tested = Tested::read()?;
        let step = |name: &String| {
            let (engine, harness) = (self.engine, name.clone());
            if let Some(tests) = passed(tested.as_ref(), root, name)? {
                return Ok(Step::new(name, Reports::Passed(engine, harness, tests)));
            }
            let line = test_line(root, name)?;
            Ok(Step::new(&line, Reports::Tests(engine, harness)))
        };
        self.wanted().map(step).collect()
    }

    /// The existing checks that a quick run leaves out.
    pub(crate) fn listed(&self, root: &Path, stop: &Interrupts) -> io::Result<Listed> {
        let full = self.rows.iter().filter(|(_, quick)| !**quick);
        let full: Vec<_> = full.map(|(name, _)| name).collect();
        if full.is_empty() {
            return Ok(Ok(BTreeSet::new()));
        }
        let file = match self.engine {
            Engine::Test | Engine::Proptest | Engine::Vector => |name: &str| file_of(name).into(),
            Engine::LibFuzzer => |name: &str| format!("fuzz/fuzz_targets/{name}.rs"),
            _ => return self.listed_by_programs(root, stop),
        };
        let is_there = |name: &&String| root.join(file(name)).is_file();
        Ok(Ok(full.into_iter().filter(is_there).cloned().collect()))
    }

    /// The checks that the programs of the engine list.
    fn listed_by_programs(&self, root: &Path, stop: &Interrupts) -> io::Result<Listed> {
        let mut all = BTreeSet::new();
        for program in programs(self.engine)? {
            match self.list(&program, root, stop)? {
                Ok(listed) => all.extend(listed),
                Err(why) => return Ok(Err(why)),
            }
        }
        Ok(Ok(all))
    }

    /// The checks that a program lists: the first word of each line.
    fn list(&self, program: &str, root: &Path, stop: &Interrupts) -> io::Result<Listed> {
        let output = target(root).join(format!("verification/{}.list", self.engine));
        let step = Step::new(program, Reports::Itself).with(["--list"]);
        match step.print(root, &output, stop)? {
            Ended::Well => {
                let text = fs::read_to_string(&output)?;
                let first = |line: &str| line.split_whitespace().next().map(str::to_owned);
                Ok(Ok(text.lines().filter_map(first).collect()))
            }
            ended => Ok(Err(format!("{ended:?} of: {step}"))),
        }
    }
}

/// `crate/tests/target.rs::test` without the test.
fn file_of(name: &str) -> &str {
    name.split_once("::").map_or(name, |(file, _)| file)
}

/// The number of tests of `crate/tests/target.rs` or `crate/src/module.rs`, or `...rs::test`, that an earlier run has
/// passed. `None` if there was no such run, or it has none of them.
fn passed(tested: Option<&Tested>, root: &Path, name: &str) -> io::Result<Option<usize>> {
    let Some(tested) = tested else {
        return Ok(None);
    };
    let (file, test) = name.split_once("::").unwrap_or((name, ""));
    let tests = if let Some(module) = module_of(file) {
        let part = format!("{module}::{test}");
        tested.passed_in_libraries(|it| it.contains(&part))
    } else {
        let (package, file) = target_of(file);
        let TestTarget { name, prefix, .. } = TestTarget::of(&root.join(package), file)?;
        tested.passed_of(&name, |it| {
            let rest = it.strip_prefix(&prefix);
            rest.is_some_and(|it| test.is_empty() || it == test)
        })
    };
    Ok((tests > 0).then_some(tests))
}

/// The command for `crate/tests/target.rs`, or for a module `crate/src/module.rs`; and for one
/// test of such a file, `...rs::test`.
///
/// The command selects the whole workspace, so that it uses the build of `cargo test --workspace`.
fn test_line(root: &Path, name: &str) -> io::Result<String> {
    let (file, test) = name.split_once("::").unwrap_or((name, ""));
    if let Some(module) = module_of(file) {
        return Ok(format!("{} --lib {module}::{test}", cargo_test(false)));
    }
    let (package, file) = target_of(file);
    let target = TestTarget::of(&root.join(package), file)?;
    let (name, prefix) = (&target.name, &target.prefix);
    let all = format!("{} --test {name}", cargo_test(target.is_slow));
    Ok(match (prefix.as_str(), test) {
        ("", "") => all,
        (prefix, "") => format!("{all} -- {prefix}"),
        (prefix, test) => format!("{all} -- --exact {prefix}{test}"),
    })
}

/// The path of a module as tests name it; `None` for a test target.
fn module_of(file: &str) -> Option<String> {
    let (_, module) = file.trim_end_matches(".rs").split_once("/src/")?;
    Some(module.trim_end_matches("/mod").replace('/', "::"))
}

/// The package and the name of a file of tests.
fn target_of(file: &str) -> (&str, &str) {
    let path = file.trim_end_matches(".rs");
    path.rsplit_once("/tests/").unwrap_or((path, ""))
}

/// Cargo's target folder.
pub(crate) fn target(root: &Path) -> PathBuf {
    env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), |it| root.join(it))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_models_are_three_programs_of_one_profile() {
        let programs = programs(Engine::Model).unwrap();
        let names = ["model", "link-model", "lockstep-model"];
        assert_eq!(programs.len(), names.len());
        for (program, name) in programs.iter().zip(names) {
            let end = format!(" -p sm2-verification --profile model --bin {name} --");
            assert!(program.ends_with(&end), "{program}");
        }
    }

    #[test]
    fn a_row_has_the_passed_tests_of_its_file_or_one_of_them() {
        let root = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."));
        let text = "
     Running tests/main.rs (target/debug/deps/verification-1)
test model::one ... ok
test model::two ... ok
test walk::one ... ok
";
        let tested = Tested(text.to_owned());
        let passed = |name| passed(Some(&tested), root, name).unwrap();
        assert_eq!(passed("verification/tests/model.rs"), Some(2));
        assert_eq!(passed("verification/tests/model.rs::two"), Some(1));
        assert_eq!(passed("verification/tests/model.rs::three"), None);
    }
}
