//! Checks that the list of mutants fits the current code. `cargo run -p sm2-verification --bin
//! mutants` checks that each mutant is found.

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use sm2_verification::mutants::{Catalogue, Check, Killed, Mutant, Outcome, Verdict};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn catalogue() -> Catalogue {
    Catalogue::load(&root()).expect("a list of mutants")
}

#[test]
fn each_text_stands_once_in_its_file() {
    assert_eq!(catalogue().gaps(&root()).expect("files"), []);
}

#[test]
fn mutants_differ_and_say_what_they_are() {
    let mutants = catalogue().mutants;
    assert!(mutants.len() >= 15, "{} mutants", mutants.len());
    let mut names = BTreeSet::new();
    let mut faults = BTreeSet::new();
    for Mutant {
        name,
        breaks,
        properties,
        file,
        from,
        to,
        ..
    } in &mutants
    {
        let plain = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'_';
        assert!(name.bytes().all(plain), "{name}");
        assert!(names.insert(name), "{name} is there twice");
        assert!(
            faults.insert((file, from, to)),
            "{name} is not a fault of its own"
        );
        assert_ne!(from, to, "{name} changes nothing");
        assert!(!breaks.is_empty() && !breaks.ends_with('.'), "{name}");
        assert!(!properties.is_empty(), "{name} breaks no property");
    }
}

/// Every check exists, so that none passes by running nothing.
#[test]
fn each_check_is_in_its_file() {
    for Mutant { name, check, .. } in catalogue().mutants {
        let (file, text) = match &check {
            Check::Harness { name } => {
                let path: Vec<_> = name.split("::").collect();
                let [_, modules @ .., function] = &path[..] else {
                    panic!("{name} is not a path");
                };
                (
                    format!("src/{}.rs", modules.join("/")),
                    format!("fn {function}("),
                )
            }
            Check::Model { scope, .. } => ("model-counts.txt".to_owned(), format!("\n{scope} ")),
            Check::Test { target, test, .. } => match test.rsplit_once("::") {
                // The modules of a target are in a folder of its name.
                Some((module, test)) => {
                    let module = module.replace("::", "/");
                    let file = format!("tests/{target}/{module}.rs");
                    (file, format!("fn {test}("))
                }
                None => (format!("tests/{target}.rs"), format!("fn {test}(")),
            },
        };
        let file = check.folder().join(file);
        let file = file.display();
        let source = std::fs::read_to_string(root().join(file.to_string()));
        let source = source.unwrap_or_else(|error| panic!("{name}: {file}: {error}"));
        assert!(source.contains(&text), "{name}: {file} has no `{text}`");
    }
}

fn mutant() -> Mutant {
    Mutant {
        name: "off_by_one".to_owned(),
        breaks: "One more than the limit is granted".to_owned(),
        properties: vec!["MGR-QUOTA".to_owned()],
        file: "a.rs".into(),
        from: "<".to_owned(),
        to: "<=".to_owned(),
        check: Check::Harness {
            name: "sm2_proto::a::b".to_owned(),
        },
        full: false,
    }
}

#[test]
fn a_text_that_is_not_once_there_makes_no_mutant() {
    let mutant = mutant();
    assert_eq!(mutant.apply("a < b").as_deref(), Ok("a <= b"));
    let count = |source| mutant.apply(source).map_err(|gap| gap.count);
    assert_eq!(count("a > b"), Err(0));
    assert_eq!(count("a < b < c"), Err(2));
}

#[test]
fn only_what_a_check_found_is_ok() {
    let result = |verdict| {
        let outcome = Outcome {
            mutant: "off_by_one".to_owned(),
            check: "it".to_owned(),
            verdict,
            took: std::time::Duration::from_millis(1_260),
        };
        (outcome.is_killed(), outcome.result())
    };
    let said = || "assertion failed".to_owned();
    let line = |word, covered| format!("mutants\toff_by_one\t{word}\t1.3\t{covered}\n");
    let lines = [
        (Verdict::Killed(Killed::Said(said())), "ok", "killed by it"),
        (Verdict::Killed(Killed::Hung), "ok", "killed by it (hung)"),
        (Verdict::Survived(None), "FAILED", "survived it"),
        (Verdict::Survived(Some(said())), "FAILED", "survived it"),
        (Verdict::NotCompiled(said()), "FAILED", "does not compile"),
        (Verdict::NoUse(said()), "FAILED", "it fails without it"),
    ];
    for (verdict, word, covered) in lines {
        assert_eq!(result(verdict), (word == "ok", line(word, covered)));
    }
}
