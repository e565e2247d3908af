//! Checks that PROPERTIES.md, the runs and the Kani harnesses refer to each other.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use sm2_verification::mutants::Catalogue;
use sm2_verification::properties::{
    Check, Engine, Extent, Gap, GapKind, Listed, Outcome, Place, Proof, Register, Run, RunResults,
    checks_of, figures_page, loom_models, outcomes, proofs, summary, tests_in,
};

/// Two properties, and a check of each kind of run.
const TEXT: &str = "\
# Properties

| group | claim | bound |
| --- | --- | --- |
| ONE, TWO | numbers | up to 2 |

| engine | strength of the result |
| --- | --- |
| model | a proof |
| libFuzzer | a sample |

| property | statement | clauses |
| --- | --- | --- |
| ONE-A | One is \\| one | SM2-TRN-001, SM2-TRN-002 |
| TWO-B | Two is two |  |

## Checks

| harness | shows | engine | bound | run |
| --- | --- | --- | --- | --- |
| `small` | ONE-A, TWO-B | model | 1 node | quick |
| `large` | ONE-A | model | 2 nodes | full |

Words between the tables.

| harness | shows | engine | bound | run |
| --- | --- | --- | --- | --- |
| `bytes` | ONE-A | libFuzzer | 20 s | quick |
";

fn register(text: &str) -> Register {
    let (register, gaps) = parse(text);
    assert_eq!(gaps, []);
    register
}

fn parse(text: &str) -> (Register, Vec<Gap>) {
    Register::parse(text, &Listed::default())
}

fn outcome(engine: Engine, harness: &str, covered: &str) -> Outcome {
    Outcome {
        engine,
        harness: harness.to_owned(),
        held: true,
        time_s: 0.5,
        covered: covered.to_owned(),
    }
}

/// A quick run that agrees with all rows.
fn as_it_should_be() -> RunResults {
    let listed = BTreeSet::from(["small".to_owned(), "large".to_owned()]);
    RunResults {
        engines: BTreeMap::from([
            (Engine::Model, Extent::RanQuick(listed)),
            (Engine::LibFuzzer, Extent::RanQuick(BTreeSet::new())),
        ]),
        only: None,
        outcomes: vec![
            outcome(Engine::Model, "small", "706 states, 1379 transitions"),
            outcome(Engine::LibFuzzer, "bytes", "~99000 executions, ~4950/s"),
        ],
        tests: BTreeMap::new(),
    }
}

fn gaps(results: &RunResults) -> Vec<GapKind> {
    let gaps = results.gaps(&register(TEXT));
    gaps.into_iter().map(|it| it.kind).collect()
}

/// The gaps that reading finds after `from` was replaced by `to`.
fn broken(from: &str, to: &str) -> Vec<Gap> {
    assert_eq!(TEXT.matches(from).count(), 1, "{from}");
    parse(&TEXT.replace(from, to)).1
}

fn line(text: &str) -> Option<usize> {
    let at = TEXT.lines().position(|it| it.contains(text));
    Some(at.expect("a line with it") + 1)
}

/// The attribute of a harness.
const MARKER: &str = "#[cfg_attr(kani, kani::proof)]";

/// The first two lines of a table of checks.
const HEADS: &str = "| harness | shows | engine | bound | run |\n\
                     | --- | --- | --- | --- | --- |";

#[test]
fn every_check_of_the_repository_shows_a_property() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = fs::read_to_string(here.join("PROPERTIES.md")).expect("the tables");
    let listed = Listed::load(&here.join("..")).expect("lists");
    assert!(!listed.mutants.is_empty() && !listed.symbolic.is_empty());
    let (register, gaps) = Register::parse(&text, &listed);
    assert_eq!(gaps, []);
    // The engine, and a number of checks that it has at least.
    let least = [
        (Engine::StandIn, 50),
        (Engine::Model, 50),
        (Engine::Test, 40),
        (Engine::LibFuzzer, 15),
    ];
    for (engine, least) in least {
        assert!(register.of(engine).count() > least, "{engine}");
    }
    for proof in &listed.proofs {
        let strengths = ["Exhaustive", "BoundariesAndSamples", "Samples"];
        assert!(strengths.contains(&proof.strength.as_str()), "{proof:?}");
    }
}

#[test]
fn a_set_stands_for_its_properties() {
    let sets = "| set | properties |\n| --- | --- |\n| both | ONE-A, TWO-B |\n\n## Checks";
    let text = TEXT
        .replace("## Checks", sets)
        .replace("| ONE-A, TWO-B | model", "| both | model");
    let register = register(&text);
    let check = register.check(Engine::Model, "small").expect("a check");
    assert_eq!(check.shows, ["ONE-A", "TWO-B"]);
}

#[test]
fn listed_checks_need_no_row() {
    let text = TEXT.replace(
        "| model | a proof |",
        "| model | a proof |\n| stand-in | paths |\n| angr | paths |\n| mutants | faults |",
    );
    let mutants = "[[mutant]]\nname = \"off_by_one\"\nbreaks = \"One\"\nproperties = [\"TWO-B\"]\n\
                   file = \"a.rs\"\nfrom = \"<\"\nto = \"<=\"\n\
                   check = { kind = \"harness\", name = \"h\" }\n";
    let mutants = toml::from_str::<Catalogue>(mutants)
        .expect("a list")
        .mutants;
    let source = format!("// Shows ONE-A (Samples), bound: 2\n// bytes.\n{MARKER}\nfn h() {{}}");
    let mut listed = Listed {
        mutants,
        loom: loom_models("# executions model\n12 no fence, twice\n"),
        proofs: proofs(&source, "a"),
        symbolic: BTreeSet::from(["a::h".to_owned()]),
        commented: Vec::new(),
    };
    let text = text
        .replace(
            "| mutants | faults |",
            "| mutants | faults |\n| loom | orders |",
        )
        .replace("| ONE, TWO |", "| ONE, TWO, BITE |")
        .replace("| TWO-B | Two", "| BITE-LOOM | Found |  |\n| TWO-B | Two");
    let (register, gaps) = Register::parse(&text, &listed);
    assert_eq!(gaps, []);
    let shows = |engine, harness| &register.check(engine, harness).expect("a check").shows;
    assert_eq!(shows(Engine::Mutants, "off_by_one"), &["TWO-B"]);
    assert_eq!(shows(Engine::StandIn, "a::h"), &["ONE-A"]);
    assert_eq!(shows(Engine::Loom, "no fence, twice"), &["BITE-LOOM"]);
    assert_eq!(shows(Engine::Angr, "a::h"), &["ONE-A"]);
    listed.mutants[0].properties = vec!["TWO-C".to_owned()];
    let kind = GapKind::UnknownProperty("TWO-C".to_owned());
    let gap = Gap { line: None, kind };
    assert_eq!(Register::parse(&text, &listed).1, [gap]);
    listed.mutants.clear();
    listed.symbolic.clear();
    listed.proofs = proofs(&format!("// Text.\n{MARKER}\nfn h() {{}}"), "a");
    let kind = GapKind::NoClaim("a::h".to_owned());
    let gap = Gap { line: None, kind };
    assert_eq!(Register::parse(&text, &listed).1, [gap]);
}

#[test]
fn nothing_is_wrong_when_all_is_as_the_rows_say() {
    assert_eq!(gaps(&as_it_should_be()), []);
}

#[test]
fn a_check_that_covers_less_than_expected_is_found() {
    const PATHS: &str = "paths that are not rejected";
    // The engine, its figures, and the expectation that they do not meet.
    let rows = [
        (
            "stand-in, Exhaustive",
            "Exhaustive, 2 paths, 0 rejected",
            "",
        ),
        ("stand-in, Exhaustive", "Samples, 2 paths", "Exhaustive"),
        ("stand-in, Samples", "Samples, 2 paths, 2 rejected", PATHS),
        ("angr", "Symbolic, 90 paths, 2 rejected", ""),
        ("angr", "Symbolic, 0 paths, 0 rejected", PATHS),
        ("angr", "Partial, 90 paths, 2 rejected", "Symbolic"),
        ("libFuzzer", "~1000 executions, ~6100/s", ""),
        ("libFuzzer", "~999 executions", "1000 executions or more"),
        ("libFuzzer", "none", "1000 executions or more"),
        ("test", "3 tests", ""),
        ("proptest", "4 tests", ""),
        ("vector", "2 tests", "3 tests or more"),
        ("model", "706 states", ""),
    ];
    for (engine, covered, wanted) in rows {
        let word = engine.split(',').next().expect("a word");
        let text = TEXT
            .replace(
                "| `large` | ONE-A | model |",
                &format!("| `large` | ONE-A | {engine} |"),
            )
            .replace(
                "| model | a proof |",
                &format!("| model | a proof |\n| {word} | a proof |"),
            );
        let register = parse(&text).0;
        let engine = Engine::named(word).expect("an engine");
        let mut results = as_it_should_be();
        results.engines.clear();
        results.outcomes = vec![outcome(engine, "large", covered)];
        results.tests.insert("large".to_owned(), 3);
        let found = results.gaps(&register);
        let wanted = match wanted {
            "" => Vec::new(),
            wanted => vec![(line("`large`"), wanted.to_owned())],
        };
        let less = found.iter().map(|it| match &it.kind {
            GapKind::Less { wanted, .. } => (it.line.map(|it| it - 1), wanted.clone()),
            other => panic!("{other:?}"),
        });
        assert_eq!(less.collect::<Vec<_>>(), wanted, "{covered}");
        results.outcomes[0].held = false;
        assert_eq!(
            results.gaps(&register),
            [],
            "its verdict says that it failed"
        );
    }
}

#[test]
fn tests_of_a_source_are_counted() {
    let source = "
        #[test]
        fn one() {}
        //= SM2-TRN-001 test
        #[test]
        // A reason.
        #[should_panic]
        fn two() { let later = || 1; }
        #[test]
        #[ignore = \"slow\"]
        fn three() {}
        #[cfg_attr(
            not(feature = \"slow\"),
            ignore = \"slow\"
        )]
        #[test]
        fn four() {}
        proptest! {
            #[test]
            fn five(it in 1..2) {}
        }
        fn helper() {}
    ";
    assert_eq!(tests_in(source), 3);
}

#[test]
fn a_row_without_its_check_is_found() {
    let mut results = as_it_should_be();
    results.outcomes.remove(0);
    let (engine, harness) = (Engine::Model, "small".to_owned());
    assert_eq!(gaps(&results), [GapKind::Silent { engine, harness }]);
}

#[test]
fn a_full_row_is_looked_up_in_a_quick_run_and_wanted_in_a_full_one() {
    let harness = "large".to_owned();
    let engine = Engine::Model;
    let mut results = as_it_should_be();
    let listed = BTreeSet::from(["small".to_owned()]);
    results.engines.insert(engine, Extent::RanQuick(listed));
    let unlisted = GapKind::Unlisted {
        engine,
        harness: harness.clone(),
    };
    assert_eq!(gaps(&results), [unlisted]);
    results.engines.insert(engine, Extent::Ran);
    assert_eq!(gaps(&results), [GapKind::Silent { engine, harness }]);
}

#[test]
fn a_check_without_a_comment_is_found() {
    let mut results = as_it_should_be();
    let new = outcome(Engine::LibFuzzer, "words", "~7000 executions | more");
    results.outcomes.push(new);
    let (engine, harness) = (Engine::LibFuzzer, "words".to_owned());
    assert_eq!(gaps(&results), [GapKind::NoRow { engine, harness }]);
    let source = "//! Words.\n// Shows TWO-B (libFuzzer).\n#![no_main]";
    let commented = checks_of(source, "fuzz/fuzz_targets/words.rs", Place::Stem).expect("a check");
    let listed = Listed {
        commented,
        ..Listed::default()
    };
    let (register, wrong) = Register::parse(TEXT, &listed);
    assert_eq!((wrong, results.gaps(&register)), (vec![], vec![]));
}

#[test]
fn comments_say_what_checks_show() {
    let source = "//! Text.\n\n// Shows ONE-A, TWO-B (test, full), bound: 2\n// cases.\n\nuse a;\n\
                  // Shows ONE-A (model).\nscope(\"small\", 2);";
    let found = |place| {
        let checks = checks_of(source, "a/tests/b.rs", place).expect("checks");
        let check = |it: Check| (it.harness, it.engine, it.run, it.shows.len());
        checks.into_iter().map(check).collect::<Vec<_>>()
    };
    let [file, small] = ["a/tests/b.rs", "small"].map(str::to_owned);
    assert_eq!(found(Place::File), [(file, Engine::Test, Run::Full, 2)]);
    assert_eq!(found(Place::Code)[1], (small, Engine::Model, Run::Quick, 1));
    let wrong = checks_of("// Shows ONE-A (modle).\n\"small\"", "b.rs", Place::Code);
    assert_eq!(
        wrong.err(),
        Some("b.rs: there is no engine `modle`".to_owned())
    );
}

#[test]
fn who_failed_or_was_not_asked_owes_nothing() {
    let mut results = as_it_should_be();
    results.outcomes.clear();
    results.engines.insert(Engine::Model, Extent::Partly);
    results.engines.remove(&Engine::LibFuzzer);
    assert_eq!(gaps(&results), []);
    results.engines.insert(Engine::LibFuzzer, Extent::Ran);
    results.only = Some(BTreeSet::from([(Engine::Model, "small".to_owned())]));
    assert_eq!(gaps(&results), []);
}

#[test]
fn kani_has_the_rows_of_the_stand_in() {
    let row = "| `h` | TWO-B | stand-in, Samples | 2 | quick |";
    let text = TEXT
        .replace(
            "| model | a proof |",
            "| model | a proof |\n| stand-in | paths |",
        )
        .replace("Words", &format!("{HEADS}\n{row}\n\nWords"));
    let results = RunResults {
        engines: BTreeMap::from([(Engine::Kani, Extent::Ran)]),
        only: None,
        outcomes: vec![outcome(Engine::Kani, "h", "45 checks, 2/2 covers")],
        tests: BTreeMap::new(),
    };
    assert_eq!(results.gaps(&register(&text)), []);
}

#[test]
fn the_page_of_figures_has_each_check_that_reported() {
    let mut results = as_it_should_be();
    results.outcomes[1].held = false;
    results.outcomes[1].covered = "a | b".to_owned();
    let page = figures_page(&register(TEXT), &results.outcomes);
    let rows = [
        "| model | `small` | 706 states, 1379 transitions | 0.5 | ok |",
        "| libFuzzer | `bytes` | a \\| b | 0.5 | FAILED |",
    ];
    let (_, last) = page.rsplit_once("| --- |\n").expect("a table");
    assert_eq!(last.lines().collect::<Vec<_>>(), rows);
}

#[test]
fn what_the_tables_do_not_agree_about_is_found() {
    let rows = [
        ("| `small` |", "| small |", GapKind::Harness("small".into())),
        (
            "| model | 1 node",
            "| modle | 1 node",
            GapKind::Engine("modle".into()),
        ),
        (
            "1 node | quick",
            "1 node | fast",
            GapKind::Run("fast".into()),
        ),
        (
            "| Two is two |  |",
            "| Two is two | SM2-TRN |",
            GapKind::Clause("SM2-TRN".into()),
        ),
    ];
    for (from, to, kind) in rows {
        let found = broken(from, to);
        assert!(found.iter().any(|it| it.kind == kind), "{to}: {found:?}");
    }
    let rows = [
        ("1 node | quick", "1 node  | quick", GapKind::Untidy),
        ("| Two is two |  |", "| Two is two |  | |", GapKind::Untidy),
        ("| `large` |", "| `small` |", GapKind::Twice("small".into())),
        (
            "| TWO-B | Two",
            "| SIX-B | Two",
            GapKind::NoGroup("SIX-B".into()),
        ),
        ("ONE-A, TWO-B", "ONE-A", GapKind::Unshown("TWO-B".into())),
        (
            "ONE-A, TWO-B",
            "ONE-A, TWO-B, TWO-C",
            GapKind::UnknownProperty("TWO-C".into()),
        ),
        (
            "| libFuzzer | a sample |\n",
            "",
            GapKind::NoEngine(Engine::LibFuzzer),
        ),
    ];
    for (from, to, kind) in rows {
        let found = broken(from, to);
        assert!(found.iter().any(|it| it.kind == kind), "{to}: {found:?}");
    }
    let found = broken("| libFuzzer | 20 s", "| mutants | 20 s");
    assert!(
        !found
            .iter()
            .any(|it| matches!(it.kind, GapKind::Unshown(_)))
    );
    let text = TEXT.replace("ONE-A, TWO-B", "ONE-A");
    let text = text.replace("`bytes` | ONE-A | libFuzzer", "`bytes` | TWO-B | mutants");
    let found = parse(&text).1;
    let unshown = GapKind::Unshown("TWO-B".into());
    assert!(found.iter().any(|it| it.kind == unshown), "{found:?}");
}

#[test]
fn checks_are_counted_by_group_engine_and_property() {
    let tables = summary(&register(TEXT));
    let rows = [
        "| ONE, TWO | numbers | model 2, libFuzzer 1 |",
        "| model | 2 |",
        "| ONE-A | model 2, libFuzzer 1 |",
        "| TWO-B | model 1 |",
    ];
    for row in rows {
        assert!(tables.lines().any(|it| it == row), "{row}: {tables}");
    }
}

#[test]
fn lines_of_results_are_read_or_refused() {
    let line = "stand-in\ta::b\tok\t1.3\tExhaustive, 2 paths, 0 rejected\n";
    let read = outcomes(line).expect("a line");
    assert_eq!((read[0].engine, read[0].held), (Engine::StandIn, true));
    assert!(!outcomes("model\tx\tFAILED\t0.0\t\n").expect("a line")[0].held);
    for bad in [
        "model\tx\tok\t1.0",
        "mode\tx\tok\t1\ty",
        "model\tx\tyes\t1\ty",
        "model\tx\tok\t-\ty",
    ] {
        assert!(outcomes(bad).is_err(), "{bad}");
    }
}

#[test]
fn reads_names_and_claims_from_sources() {
    let source = "/// Text.\n//= SM2-TRN-001 kani\n// Shows ONE-A, TWO-B (Exhaustive), bound: up to\n// 3 bytes.\n\
                  #[cfg_attr(kani, kani::proof)]\n#[cfg_attr(kani, kani::unwind(2))]\nfn two() {}";
    let expected = Proof {
        name: "sm2_proto::a::two".to_owned(),
        shows: vec!["ONE-A".to_owned(), "TWO-B".to_owned()],
        strength: "Exhaustive".to_owned(),
    };
    assert_eq!(proofs(source, "sm2_proto::a"), [expected]);
}
