//! `model [--quick | SCOPE...]`: searches the scopes, all of them if none is named.
//! `model --list`: prints their names. `model --step SCOPE`: interactive steps through a scope.
//!
//! Prints the figures of each scope, and the shortest path to a failure; shows the progress of a long
//! search on standard error. Exit status: 0 if all properties hold and the counts equal those in
//! `model-counts.txt`, 1 if not, 2 for an unknown scope or option. If `SM2_VERIFICATION_RESULTS` names a
//! file, a line for each scope is added to it.
//!
//! `model --compare SCOPE...`: searches each scope with and without the reductions.

use std::{
    env,
    io::{self, Write as _},
    process::ExitCode,
};

use sm2_verification::model::{
    domain::{COUNTS, Findings, Scope, walk_by_hand},
    explore_telling,
};

const LIMIT: usize = 40_000_000;

enum Asked {
    List,
    Search(Vec<Scope>),
    Compare(Vec<Scope>),
    Step(Scope),
}

fn main() -> ExitCode {
    let arguments: Vec<_> = env::args().skip(1).collect();
    match asked(&arguments) {
        Ok(asked) => run(asked).unwrap_or_else(|error| {
            eprintln!("model: {error}");
            ExitCode::from(2)
        }),
        Err(wrong) => {
            eprintln!(
                "model: {wrong}; usage: model [--list | --quick | --step SCOPE | [--compare] SCOPE...]"
            );
            ExitCode::from(2)
        }
    }
}

fn asked(arguments: &[String]) -> Result<Asked, String> {
    let named = |name: &String| {
        let scope = Scope::named(name);
        scope.ok_or_else(|| format!("there is no scope {name} (--list names them)"))
    };
    let words: Vec<_> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        [] => Ok(Asked::Search(Scope::all())),
        ["--list"] => Ok(Asked::List),
        ["--quick"] => Ok(Asked::Search(Scope::quick())),
        ["--compare", _, ..] => {
            let scopes = arguments[1..].iter().map(named);
            scopes.collect::<Result<_, _>>().map(Asked::Compare)
        }
        ["--step", _] => named(&arguments[1]).map(Asked::Step),
        _ => arguments
            .iter()
            .map(named)
            .collect::<Result<_, _>>()
            .map(Asked::Search),
    }
}

fn run(asked: Asked) -> io::Result<ExitCode> {
    let mut out = io::stdout().lock();
    let mut held = true;
    match asked {
        Asked::List => {
            let quick: Vec<_> = Scope::quick().iter().map(|it| it.name).collect();
            for scope in Scope::all() {
                let mark = if quick.contains(&scope.name) {
                    " (quick)"
                } else {
                    ""
                };
                writeln!(out, "{}{mark}", scope.name)?;
            }
        }
        Asked::Compare(scopes) => {
            for scope in scopes {
                held &= compare(&mut out, &scope)?;
            }
        }
        Asked::Step(scope) => walk_by_hand(&scope, &mut io::stdin().lock(), &mut out)?,
        Asked::Search(scopes) => {
            for scope in scopes {
                let report = explore_telling(&scope, LIMIT, |so_far| {
                    eprintln!(
                        "  {}: {} states, {} of them waiting, depth {}",
                        scope.name, so_far.states, so_far.waiting, so_far.depth
                    );
                });
                held &= COUNTS.tell(&mut out, scope.name, &report)?;
            }
        }
    }
    Ok(ExitCode::from(u8::from(!held)))
}

fn compare(out: &mut impl io::Write, scope: &Scope) -> io::Result<bool> {
    let [reduced, whole] = [true, false].map(|reduced| {
        Findings::of(&Scope {
            reduced,
            ..scope.clone()
        })
    });
    let name = scope.name;
    match (reduced, whole) {
        (Ok(reduced), Ok(whole)) => {
            let same = reduced.say_the_same(&whole);
            let (few, all) = (reduced.states, whole.states);
            let verdict = if same { "the same" } else { "NOT the same" };
            let quiet = whole.quiet.len();
            writeln!(
                out,
                "{name}: {few} states of {all} say {verdict}, {quiet} quiet moments but for names"
            )?;
            Ok(same)
        }
        (one, other) => {
            for failed in [one.err(), other.err()].into_iter().flatten() {
                writeln!(out, "{name}: {}", failed.failure)?;
            }
            Ok(false)
        }
    }
}

#[cfg(test)]
mod tests {
    use sm2_verification::model::domain::Fault;

    use super::*;

    /// The exit status of a search, as text: it cannot be compared.
    fn status(scopes: &[&Scope]) -> String {
        let scopes = scopes.iter().copied().cloned().collect();
        format!("{:?}", run(Asked::Search(scopes)).unwrap())
    }

    #[test]
    fn a_failure_in_any_scope_makes_the_status_1() {
        let sound = Scope::named("cold-2x2").unwrap();
        let broken = Scope {
            fault: Some(Fault::LinkTwice),
            ..sound.clone()
        };
        let [held, failed] = [0, 1].map(|it| format!("{:?}", ExitCode::from(it)));
        assert_eq!(status(&[&sound]), held);
        assert_eq!(status(&[&broken, &sound]), failed);
    }
}
