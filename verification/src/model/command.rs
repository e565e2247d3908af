//! The command line of a program that searches scopes: `PROGRAM [--quick] [--list] [SCOPE...]`.

use std::env;
use std::fmt;
use std::io::{self, Write as _};
use std::process::ExitCode;

use super::{Golden, System, explore};

const LIMIT: usize = 10_000_000;

/// A scope that such a program can search.
pub trait Scope: System<Action: fmt::Display> + Sized {
    /// The expected counts.
    const COUNTS: Golden;

    /// All scopes.
    fn all() -> Vec<Self>;

    /// The name.
    fn name(&self) -> &'static str;

    /// True if the search takes only seconds.
    fn is_quick(&self) -> bool;
}

/// Searches the scopes that the command line names, all of them if it names none.
///
/// Prints the figures of each scope, and the shortest path to a failure. Exit status: 0 if all properties hold and the
/// counts are the expected ones, 1 if not, 2 for an unknown scope. If `SM2_VERIFICATION_RESULTS` names a file, a line
/// for each scope is added to it.
#[must_use]
pub fn run<S: Scope>(program: &str, about: &str) -> ExitCode {
    match search::<S>(program, about) {
        Ok(code) => code,
        Err(error) => {
            let _ = writeln!(io::stderr(), "{program}: {error}");
            ExitCode::from(2)
        }
    }
}

fn search<S: Scope>(program: &str, about: &str) -> io::Result<ExitCode> {
    let usage = format!(
        "usage: {program} [--quick] [--list] [SCOPE...]
{about}: those named, else all.
  --quick  only those that take seconds
  --list   only say which there are"
    );
    let (options, names): (Vec<_>, Vec<_>) =
        env::args().skip(1).partition(|it| it.starts_with('-'));
    let mut out = io::stdout().lock();
    let [mut quick, mut list] = [false; 2];
    for option in options {
        match option.as_str() {
            "--quick" => quick = true,
            "--list" => list = true,
            "--help" | "-h" => {
                writeln!(out, "{usage}")?;
                return Ok(ExitCode::SUCCESS);
            }
            _ => {
                writeln!(io::stderr(), "{usage}")?;
                return Ok(ExitCode::from(2));
            }
        }
    }
    let mut scopes = S::all();
    let all: Vec<_> = scopes.iter().map(Scope::name).collect();
    if let Some(unknown) = names.iter().find(|it| !all.contains(&it.as_str())) {
        let all = all.join(", ");
        writeln!(
            io::stderr(),
            "there is no scope {unknown}; there are: {all}"
        )?;
        return Ok(ExitCode::from(2));
    }
    scopes.retain(|it| names.is_empty() || names.iter().any(|name| name == it.name()));
    scopes.retain(|it| it.is_quick() || !quick);
    let mut held = true;
    for scope in scopes {
        if list {
            writeln!(out, "{}", scope.name())?;
            continue;
        }
        let report = explore(&scope, LIMIT);
        held &= S::COUNTS.tell(&mut out, scope.name(), &report)?;
    }
    Ok(ExitCode::from(u8::from(!held)))
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::super::{Failure, Property, fail};
    use super::*;

    /// The names of scopes are those of tests, too: a search reads the command line of its process, whose words select
    /// the tests here.
    const SOUND: &str = "a_failure_in_any_scope";
    const BROKEN: &str = "a_failure_in_any_scope_makes_the_status_1";

    /// One moment, which is sound or not.
    struct Moment(&'static str);

    impl System for Moment {
        type Moment = ();
        type Action = u8;

        fn first(&self) -> Result<(), Failure> {
            Ok(())
        }

        fn actions(&self, (): &()) -> Vec<u8> {
            Vec::new()
        }

        fn check(&self, (): &(), _: &[u8]) -> Result<bool, Failure> {
            match self.0 {
                SOUND => Ok(true),
                _ => fail(Property::Invariants, "broken".to_owned()),
            }
        }

        fn step(&self, (): &(), action: u8) -> Result<(), Failure> {
            unreachable!("{action}")
        }
    }

    impl Scope for Moment {
        const COUNTS: Golden = Golden {
            file: "this file",
            text: "a_failure_in_any_scope 1 0 0 1",
        };

        fn all() -> Vec<Self> {
            vec![Self(BROKEN), Self(SOUND)]
        }

        fn name(&self) -> &'static str {
            self.0
        }

        fn is_quick(&self) -> bool {
            true
        }
    }

    #[test]
    fn a_failure_in_any_scope_makes_the_status_1() {
        let words: Vec<_> = env::args().skip(1).collect();
        if words.iter().any(|it| it == SOUND) {
            let expected = ExitCode::from(u8::from(words.len() > 1));
            let status = run::<Moment>("program", "Searches");
            assert_eq!(format!("{status:?}"), format!("{expected:?}"));
            return;
        }
        for words in [&[SOUND][..], &[SOUND, BROKEN]] {
            let mut command = Command::new(env::current_exe().unwrap());
            command.args(words).env_remove("SM2_VERIFICATION_RESULTS");
            let output = command.output().unwrap();
            assert!(output.status.success(), "{words:?}: {output:?}");
            let said = String::from_utf8_lossy(&output.stdout);
            assert!(said.contains(". 1 passed"), "{words:?}: {said}");
        }
    }
}
