//! Runs the clause checker on workspaces of a few lines, one for each finding.
//!
//! The sources are strings within one line each, so that this file cites no clause itself.

use std::fs;
use std::path::Path;

use sm2_verification::clauses::{self, CheckError, CheckKind, ClauseId, Level, Report};
use tempfile::TempDir;

const MUST: &str = "# Title\n\n**SM2-MGR-001** [MUST] The Manager MUST answer.\n";
const CODE: &str = "//= SM2-MGR-001\nfn answer() {}\n";
const TEST: &str = "    //= SM2-MGR-001 test\n    fn answers() {}\n";

/// A workspace with these files, which is removed when dropped.
fn workspace(files: &[(&str, &str)]) -> TempDir {
    let root = TempDir::new().expect("a temporary folder");
    for (path, text) in files {
        let path = root.path().join(path);
        fs::create_dir_all(path.parent().expect("below the root")).expect("a folder");
        fs::write(path, text).expect("a file");
    }
    root
}

fn check(files: &[(&str, &str)]) -> Report {
    clauses::check(workspace(files).path()).expect("SPEC.md is there")
}

/// The gaps as they are printed.
fn gaps(files: &[(&str, &str)]) -> Vec<String> {
    check(files)
        .gaps()
        .iter()
        .map(ToString::to_string)
        .collect()
}

fn id(text: &str) -> ClauseId {
    ClauseId::parse(text).expect("an id")
}

#[test]
fn passes_when_code_and_a_check_cite_each_must() {
    let report = check(&[
        ("SPEC.md", MUST),
        ("sm2-proto/src/lib.rs", CODE),
        ("sm2-proto/tests/table.rs", TEST),
    ]);
    assert_eq!(report.gaps(), []);
    assert_eq!(
        report.summary(),
        "clauses: 1 MUST, 0 SHOULD, 0 MAY, 0 DRAFT, 0 RETIRED; 1 code links, 1 check links; 0 gaps"
    );
    let traced = &report.clauses()[&id("SM2-MGR-001")];
    assert_eq!(traced.level, Level::Must);
    assert_eq!(traced.at.to_string(), "SPEC.md:3");
    assert_eq!(traced.code[0].to_string(), "sm2-proto/src/lib.rs:1");
    assert_eq!(traced.checks[0].0, CheckKind::Test);
}

#[test]
fn a_missing_spec_is_one_clear_line() {
    let root = workspace(&[("src/lib.rs", CODE)]);
    let error = clauses::check(root.path()).expect_err("nothing to check against");
    assert!(matches!(error, CheckError::NoSpec(_)));
    let text = error.to_string();
    assert!(
        text.contains("SPEC.md is missing") && !text.contains('\n'),
        "{text}"
    );
}

#[test]
fn an_empty_spec_passes() {
    assert!(gaps(&[("SPEC.md", "# No clause yet\n")]).is_empty());
}

#[test]
fn a_must_needs_code() {
    let found = gaps(&[("SPEC.md", MUST), ("t.rs", TEST)]);
    assert_eq!(found, ["SPEC.md:3: SM2-MGR-001: no code cites this MUST"]);
}

#[test]
fn a_must_needs_a_check() {
    let found = gaps(&[("SPEC.md", MUST), ("a.rs", CODE)]);
    assert_eq!(found, ["SPEC.md:3: SM2-MGR-001: no check cites this MUST"]);
}

#[test]
fn a_must_that_nobody_cites_lacks_both() {
    assert_eq!(gaps(&[("SPEC.md", MUST)]).len(), 2);
}

#[test]
fn should_and_may_need_nothing_but_can_be_cited() {
    let spec = "**SM2-TOP-001** [SHOULD] A.\n**SM2-TOP-002** [MAY] B.\n**SM2-TOP-003** [MAY] C.\n";
    let code = "//= SM2-TOP-001, SM2-TOP-002\n";
    let report = check(&[("SPEC.md", spec), ("a.rs", code)]);
    assert_eq!(report.gaps(), []);
    assert_eq!(report.clauses()[&id("SM2-TOP-002")].code.len(), 1);
}

#[test]
fn a_draft_is_not_cited() {
    let spec = "**SM2-RES-001** [DRAFT] A Manager MUST resume.\n";
    assert!(gaps(&[("SPEC.md", spec)]).is_empty());
    for citation in ["//= SM2-RES-001\n", "//= SM2-RES-001 test\n"] {
        let found = gaps(&[("SPEC.md", spec), ("a.rs", citation)]);
        assert_eq!(
            found,
            ["a.rs:1: SM2-RES-001 is a DRAFT: cite it once it is in force"]
        );
    }
}

#[test]
fn a_retired_id_is_neither_cited_nor_used_again() {
    let retired = "~~SM2-MGR-001~~ [RETIRED] replaced in version 2\n";
    assert!(gaps(&[("SPEC.md", retired)]).is_empty());
    assert!(gaps(&[("SPEC.md", "~~SM2-MGR-001~~ [RETIRED]\n")]).is_empty());

    let found = gaps(&[("SPEC.md", retired), ("a.rs", CODE)]);
    assert_eq!(
        found,
        ["a.rs:1: SM2-MGR-001 is RETIRED: nothing may cite it"]
    );

    let again = format!("{retired}**SM2-MGR-001** [MAY] Something else.\n");
    let found = gaps(&[("SPEC.md", &again)]);
    assert_eq!(
        found,
        ["SPEC.md:2: SM2-MGR-001 is used twice, first at SPEC.md:1; ids are never used again"]
    );
}

#[test]
fn a_clause_that_the_program_names_is_in_force() {
    let spec = "**SM2-TOP-001** [MAY] A.\n~~SM2-TOP-002~~ [RETIRED]\n";
    let code = "let a = clause!(\"SM2-TOP-001\");\n\
                let b = violation!(\n    BadWord,\n    \"SM2-TOP-002\"\n);\n\
                let c = violation!(BadWord, \"SM2-TOP-003\");\n\
                macro_rules! d { ($id:literal) => { clause!($id) } }\n";
    assert_eq!(
        gaps(&[("SPEC.md", spec), ("a.rs", code)]),
        [
            "a.rs:2: SM2-TOP-002 is RETIRED: nothing may cite it",
            "a.rs:6: unknown clause SM2-TOP-003"
        ]
    );
}

#[test]
fn an_id_names_one_clause() {
    let spec = "**SM2-MGR-001** [MAY] A.\n\n**SM2-MGR-001** [MAY] B.\n";
    let found = gaps(&[("SPEC.md", spec)]);
    assert_eq!(
        found,
        ["SPEC.md:3: SM2-MGR-001 is used twice, first at SPEC.md:1; ids are never used again"]
    );
}

#[test]
fn a_clause_line_that_does_not_parse_is_reported() {
    let malformed = [
        "**SM2-MGR-1** [MUST] Two digits are missing.",
        "**SM2-mgr-001** [MUST] Small letters.",
        "**SM2-MGR-0011** [MUST] A digit too many.",
        "**SM2-MGR-001** MUST No brackets.",
        "**SM2-MGR-001** [SHALL] No such level.",
        "**SM2-MGR-001** [RETIRED] Not struck out.",
        "**SM2-MGR-001** [MUST]",
        "**SM2-MGR-001** [MUST]  ",
        "**SM2-MGR-001**  [MUST] Two blanks.",
        "~~SM2-MGR-001~~ [MUST] Struck out and in force.",
        "~~SM2-MGR-001~~",
        "- **SM2-MGR-001** [MUST] In a list.",
        "  **SM2-MGR-001** [MUST] Indented.",
        "See - ~~SM2-MGR-001~~ [RETIRED]",
    ];
    for line in malformed {
        let found = gaps(&[("SPEC.md", line)]);
        assert!(
            found
                .first()
                .is_some_and(|gap| gap.starts_with("SPEC.md:1: malformed clause line")),
            "{line}: {found:?}"
        );
    }
}

#[test]
fn the_text_refers_to_clauses_that_exist() {
    let spec = "**SM2-MGR-001** [MAY] See SM2-MGR-002 and **SM2-MGR-001**.\n";
    let found = gaps(&[("SPEC.md", spec)]);
    assert_eq!(
        found,
        ["SPEC.md:1: the text refers to SM2-MGR-002, which is not a clause"]
    );
}

#[test]
fn procedures_mention_each_frame_code_and_fate() {
    let spec = "# Title\n\n## 7. Link frames\n\n| no | kind |\n| --- | --- |\n| 1 | OPEN |\n| 7 | RELEASE |\n\n\
                ## 9. Services\n\n| 3 | free |\n\n## 10. Codes\n\n| 74 | `bad-release` | text |\n\
                | 75 | `bad-id` | text |\n\n<!-- ANCHOR: fates -->\n| `closed` | text |\n| `expired` | text |\n\
                <!-- ANCHOR_END: fates -->\n\n\
                ## Annex B. Procedures\n\n*OPEN comes:* `bad-id`, `bad-release-2`, `closed`.\n\n\
                ## Annex C. An example\n\nRELEASE `bad-release` `expired`\n";
    assert_eq!(
        gaps(&[("SPEC.md", spec)]),
        [
            "SPEC.md:8: no procedure of Annex B mentions RELEASE",
            "SPEC.md:16: no procedure of Annex B mentions bad-release",
            "SPEC.md:21: no procedure of Annex B mentions expired",
        ]
    );
}

#[test]
fn an_unknown_id_is_reported_at_its_line() {
    let found = gaps(&[
        ("SPEC.md", "# None\n"),
        ("a/b.rs", "\n\n//= SM2-XYZ-123 kani\n"),
    ]);
    assert_eq!(found, ["a/b.rs:3: unknown clause SM2-XYZ-123"]);
}

#[test]
fn an_unreadable_citation_is_reported() {
    let unreadable = [
        "//= SM2-MGR-001 tests",
        "//= SM2-MGR-001 test please",
        "//= SM2-MGR-001,",
        "//= SM2-MGR-001 SM2-MGR-001",
        "//= SM2-MGR-0010",
        "//= SM2-MGR-001test",
        "//= MGR-001",
        "//= sm2-mgr-001",
        "//=",
    ];
    for line in unreadable {
        let found = gaps(&[("SPEC.md", "# None\n"), ("a.rs", line)]);
        assert_eq!(found.len(), 1, "{line}: {found:?}");
        assert!(
            found[0].starts_with("a.rs:1: unreadable citation"),
            "{line}: {found:?}"
        );
    }
}

#[test]
fn rulers_and_other_comments_are_not_citations() {
    let text = "//==========\n/// //= SM2-XYZ-001\n// = SM2-XYZ-001\nx(); //= SM2-XYZ-001\n";
    assert!(gaps(&[("SPEC.md", "# None\n"), ("a.rs", text)]).is_empty());
}

#[test]
fn every_kind_of_check_counts() {
    for kind in CheckKind::ALL {
        let citation = format!("//=SM2-MGR-001   {kind}  \n");
        let files = [
            ("SPEC.md", MUST),
            ("a.rs", CODE),
            ("b.rs", citation.as_str()),
        ];
        let report = check(&files);
        assert_eq!(report.gaps(), []);
        assert_eq!(report.clauses()[&id("SM2-MGR-001")].checks[0].0, kind);
    }
}

#[test]
fn scripts_and_settings_cite_with_a_hash() {
    let cites = "#= SM2-MGR-001\n#= SM2-MGR-001 sys\n";
    for path in [
        "a.toml",
        "a.py",
        "b/a.sh",
        ".github/workflows/a.yml",
        ".ci/run",
    ] {
        let report = check(&[("SPEC.md", MUST), (path, cites)]);
        assert_eq!(report.gaps(), [], "{path}");
    }
}

#[test]
fn vectors_are_checks() {
    let vectors = [
        "[{\"clause\": \"SM2-MGR-001\"},\n {\"clause\":null}]\n",
        "[{ \"clause\" : \"SM2-MGR-001\", \"why\": \"\\\"clause\\\": 1\" }]",
    ];
    for text in vectors {
        let report = check(&[
            ("SPEC.md", MUST),
            ("a.rs", CODE),
            ("tests/vectors/a.json", text),
        ]);
        assert_eq!(report.gaps(), [], "{text}");
        let checks = &report.clauses()[&id("SM2-MGR-001")].checks;
        assert_eq!(checks.len(), 1);
        assert_eq!(checks[0].0, CheckKind::Vector);
    }
}

#[test]
fn vectors_name_real_clauses() {
    let path = "tests/vectors/a.json";
    let found = gaps(&[
        ("SPEC.md", "# None\n"),
        (path, "{\n\"clause\": \"SM2-XYZ-001\"}"),
    ]);
    assert_eq!(
        found,
        ["tests/vectors/a.json:2: unknown clause SM2-XYZ-001"]
    );
    for value in ["\"MGR-1\"", "\"SM2-MGR-0011\"", "7", ""] {
        let text = format!("{{\"clause\": {value}}}");
        let found = gaps(&[("SPEC.md", "# None\n"), (path, &text)]);
        assert!(
            found[0].contains("unreadable citation"),
            "{value}: {found:?}"
        );
    }
}

#[test]
fn build_output_hidden_folders_and_other_files_are_passed_over() {
    let cites = "//= SM2-XYZ-001\n\"clause\": \"SM2-XYZ-001\"\n#= SM2-XYZ-001\n";
    let skipped = [
        "target/a.rs",
        "fuzz/target/a.rs",
        ".git/a.rs",
        "notes.md",
        "a.json",
        "tests/a.json",
        "fuzz/corpus/link_frames/seed",
    ];
    for path in skipped {
        let found = gaps(&[("SPEC.md", "# None\n"), (path, cites)]);
        assert!(found.is_empty(), "{path}: {found:?}");
    }
}

#[test]
fn text_that_is_not_utf8_is_read_all_the_same() {
    let root = workspace(&[("SPEC.md", "# None\n")]);
    fs::write(root.path().join("a.rs"), b"// \xff\n//= SM2-XYZ-001\n").expect("a file");
    let report = clauses::check(root.path()).expect("readable");
    assert_eq!(report.gaps().len(), 1);
    assert_eq!(report.gaps()[0].at.file, Path::new("a.rs"));
}

#[test]
fn an_id_is_read_exactly() {
    assert_eq!(id("SM2-MGR-012").to_string(), "SM2-MGR-012");
    for text in [
        "",
        "SM2-MGR-01",
        "SM2-MGR-0123",
        "SM2_MGR-012",
        "SM2-MG1-012",
        "SM2-MGR-01é",
    ] {
        assert_eq!(ClauseId::parse(text), None, "{text}");
    }
}
