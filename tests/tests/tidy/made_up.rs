//! Made-up crates that show each check fail.

use std::path::Path;

use serde_json::json;

use super::{
    causes, cycles, edges, modules, packages, prose, repetition, sizes, sources::Sources, types,
};

/// The edges of a crate of these files, as `from -> to`.
fn edges_of(files: &[(&str, &str)]) -> Vec<String> {
    let sources = Sources::made_up(files);
    let modules = modules::read_crate(&sources, Path::new("src/lib.rs"));
    let name = |path: &Path| path.file_stem().unwrap().to_string_lossy().into_owned();
    let edges = edges::edges(&modules);
    let show = |it: &edges::Edge| format!("{} -> {}", name(&it.from), name(&it.to));
    edges.iter().map(show).collect()
}

#[test]
fn a_cycle_is_found_and_shown() {
    let sources = Sources::made_up(&[
        ("src/lib.rs", "mod a; mod b; mod c;"),
        ("src/a.rs", "use crate::b::B;\npub struct A(B);"),
        ("src/b.rs", "pub struct B;\nfn f() -> super::c::C {}"),
        (
            "src/c.rs",
            "pub struct C;\nfn f() { use crate::a::{self, A as X}; }",
        ),
    ]);
    let modules = modules::read_crate(&sources, Path::new("src/lib.rs"));
    let knots = cycles::knots(&edges::edges(&modules));
    assert_eq!(knots.len(), 1);
    assert_eq!(knots[0].files.len(), 3);
    let text = knots[0].to_string();
    for line in [
        "src/a.rs:1 names crate::b::B of src/b.rs",
        "src/b.rs:2 names super::c::C of src/c.rs",
        "src/c.rs:2 names crate::a::A of src/a.rs",
    ] {
        assert!(text.contains(line), "{text}");
    }
}

#[test]
fn an_item_is_looked_for_where_it_is_defined() {
    let found = edges_of(&[
        (
            "src/lib.rs",
            "mod a; mod b; pub use a::A; pub use b::*; pub use std::fmt::Debug;",
        ),
        ("src/a.rs", "pub struct A; pub struct Other;"),
        (
            "src/b.rs",
            "mod inner; pub use inner::I; use crate::{A, Debug}; use inner::J;",
        ),
        (
            "src/b/inner.rs",
            "use crate::I; pub struct I; pub struct J;",
        ),
    ]);
    assert_eq!(found, ["b -> a", "b -> inner"]);
    let through_glob = edges_of(&[
        ("src/lib.rs", "mod a; mod b; pub use b::*;"),
        ("src/a.rs", "use crate::B;"),
        ("src/b.rs", "pub struct B;"),
    ]);
    assert_eq!(through_glob, ["a -> b"]);
}

#[test]
fn paths_in_code_and_in_macros_count() {
    let found = edges_of(&[
        ("src/lib.rs", "mod a; mod b; mod c; mod d;"),
        ("src/a.rs", "pub fn f() {}"),
        ("src/b.rs", "use crate::a; fn g() { a::f(); }"),
        ("src/c.rs", "fn g() { assert!(1 + super::a::f()); }"),
        ("src/d.rs", "use crate::a;"),
    ]);
    assert_eq!(found, ["b -> a", "c -> a"]);
}

#[test]
fn reexports_tests_and_mere_modules_do_not_count() {
    let found = edges_of(&[
        ("src/lib.rs", "mod a; mod b;"),
        (
            "src/a.rs",
            "mod c; pub use crate::b::B; #[cfg(test)] use crate::b::B;",
        ),
        (
            "src/b.rs",
            "pub struct B; #[cfg(all(test, unix))] mod tests { use crate::a::c::C; }",
        ),
        (
            "src/a/c.rs",
            "pub struct C; #[cfg(kani)] fn f() { crate::b::B; }",
        ),
    ]);
    assert_eq!(found, Vec::<String>::new());
    let other = edges_of(&[
        ("src/lib.rs", "mod a; mod b;"),
        ("src/a.rs", "#[cfg(not(test))] use crate::b::B;"),
        ("src/b.rs", "pub struct B;"),
    ]);
    assert_eq!(other, ["a -> b"]);
}

#[test]
fn a_macro_belongs_to_the_file_that_defines_it() {
    let found = edges_of(&[
        ("src/lib.rs", "mod a; mod b; mod c;"),
        (
            "src/a.rs",
            "#[macro_export] macro_rules! shout { () => {} }",
        ),
        ("src/b.rs", "use crate::shout;"),
        ("src/c.rs", "crate::shout!();"),
    ]);
    assert_eq!(found, ["b -> a", "c -> a"]);
}

#[test]
fn sizes_are_measured() {
    let path = Path::new("src/lib.rs");
    let at_most = "\n".repeat(500);
    assert_eq!(sizes::long_file(path, &at_most), []);
    let text = sizes::long_file(path, &format!("{at_most}\n"))[0].to_string();
    assert_eq!(text, "src/lib.rs:501: 501 lines: split it (500 at most)");

    let columns = "\u{e4}".repeat(120);
    assert_eq!(sizes::long_lines(path, &columns), []);
    let text = sizes::long_lines(path, &format!("\n{columns}x"))[0].to_string();
    assert_eq!(text, "src/lib.rs:2: 121 columns: wrap it (120 at most)");

    let line = "x ".repeat(60) + "x";
    let free = format!("```text\n{line}\n```\n\n| {line} |\n\n**SM2-TRN-001** [MUST] {line}\n");
    assert_eq!(sizes::long_markdown_lines(path, &free), []);
    let text = sizes::long_markdown_lines(path, &format!("{free}\n{line}"))[0].to_string();
    assert_eq!(text, "src/lib.rs:9: 121 columns: wrap it (120 at most)");

    let document = Path::new("CHANGELOG.md");
    assert_eq!(sizes::long_document(document, &"x".repeat(4_000)), []);
    let text = sizes::long_document(document, &"x".repeat(4_001))[0].to_string();
    assert_eq!(
        text,
        "CHANGELOG.md:1: 4001 bytes: shorten it (4000 at most)"
    );
    assert_eq!(sizes::long_document(path, &"x".repeat(20_000)), []);

    for (before, after) in [("", ""), ("impl A {", "}"), ("trait A {", "}")] {
        let function = |lines: usize| {
            let body = "\n".repeat(lines - 1);
            format!("{before}\n#[inline]\nfn f() {{{body}}}{after}")
        };
        assert_eq!(sizes::long_functions(path, &function(70)), []);
        let text = sizes::long_functions(path, &function(71))[0].to_string();
        assert_eq!(text, "src/lib.rs:3: f has 71 lines: split it (70 at most)");
    }
}

#[test]
fn a_package_that_lacks_metadata_is_found() {
    let mut package = json!({
        "manifest_path": "/a/Cargo.toml",
        "publish": null,
        "description": "A package",
        "license": "MIT",
        "repository": "https://example.org",
        "readme": "README.md",
        "rust_version": "1.88",
        "keywords": ["a"],
        "categories": ["b"],
        "metadata": { "docs": { "rs": { "all-features": true } } },
    });
    assert!(packages::is_published(&package));
    assert!(packages::missing(&package, &|_| true).is_empty());
    let no_licence = |path: &Path| path != Path::new("/a/LICENSE-MIT");
    let missing = packages::missing(&package, &no_licence);
    assert_eq!(missing, ["the file LICENSE-MIT"]);
    package["readme"] = json!(null);
    package["keywords"] = json!(["a", "b", "c", "d", "e", "f"]);
    package["metadata"] = json!(null);
    let missing = packages::missing(&package, &|_| true);
    let docs = "all-features in [package.metadata.docs.rs]";
    assert_eq!(missing, ["the field readme", "1 to 5 keywords", docs]);
    package["publish"] = json!([]);
    assert!(!packages::is_published(&package));
}

#[test]
fn repeated_lines_are_found() {
    let lines = |from: usize, to: usize| -> String {
        (from..to)
            .map(|it| format!("    let a{it} = {it};\n\n"))
            .collect()
    };
    let uses = "use a::{\n    b,\n};\n// A comment.\n}\n".repeat(4);
    let first = lines(0, 12);
    let nine = lines(3, 12);
    let (a, b) = (Path::new("a.rs"), Path::new("b.rs"));
    let second = format!("{uses}{nine}");
    assert_eq!(repetition::repetitions([(a, &*first), (b, &*second)]), []);
    let second = format!("{uses}{}", first.replace("    ", ""));
    let found = repetition::repetitions([(a, &*first), (b, &*second)]);
    let expected = repetition::Repetition {
        file: b.to_owned(),
        line: 21,
        first: (a.to_owned(), 1),
        count: 12,
    };
    assert_eq!(found, [expected]);
    let same_line = "    x();\n".repeat(19);
    assert_eq!(repetition::repetitions([(a, &*same_line)]), []);
}

#[test]
fn flags_of_structures_are_counted() {
    let text = "struct Three { a: bool, b: bool, c: bool, d: Option<bool>, e: u8 }
        fn f() { struct Four(bool, bool, bool, bool); }
        #[derive(Debug, clap::Args)] struct Options { a: bool, b: bool, c: bool, d: bool }
        #[derive(Debug, Clone)] struct Five { a: bool, b: bool, c: bool, d: bool, e: bool }";
    let found = types::many_flags(Path::new("a.rs"), text);
    let found: Vec<_> = found.iter().map(|it| &*it.text).collect();
    let expected = [
        "a.rs:2: Four has 4 bools (3 at most)",
        "a.rs:4: Five has 5 bools (3 at most)",
    ];
    assert_eq!(found, expected);
}

#[test]
fn files_that_implement_a_type_are_counted() {
    let root = "mod ty; mod other; mod a; mod b; mod c; mod d; mod e; mod f; use ty::T;";
    let block = "use crate::T; impl T {} impl T {} impl<U> From<U> for Vec<T> {}";
    let scattered = |root: &str| -> Vec<String> {
        let files = [
            ("src/lib.rs", root),
            ("src/ty.rs", "pub struct T; impl T {}"),
            ("src/other.rs", "struct T; impl T {}"),
            ("src/a.rs", block),
            ("src/b.rs", block),
            ("src/c.rs", block),
            ("src/d.rs", block),
            ("src/e.rs", "impl Clone for super::ty::T {}"),
            (
                "src/f.rs",
                "#[cfg(test)] mod tests { impl super::super::T {} }",
            ),
        ];
        let modules = modules::read_crate(&Sources::made_up(&files), Path::new("src/lib.rs"));
        let found = types::scattered_types(&modules).into_iter();
        found.map(|it| it.text).collect()
    };
    assert_eq!(scattered(root), Vec::<String>::new());
    let files = "src/a.rs, src/b.rs, src/c.rs, src/d.rs, src/e.rs, src/lib.rs, src/ty.rs";
    assert_eq!(
        scattered(&format!("{root} impl Drop for T {{}}")),
        [format!(
            "T of src/ty.rs has impl blocks in 7 files (6 at most): {files}"
        )]
    );
}

#[test]
fn sentences_that_readers_stumble_over_are_found() {
    let found = |path: &str, text: &str| -> Vec<String> {
        let findings = prose::stumbling_sentences(Path::new(path), text);
        findings.iter().map(ToString::to_string).collect()
    };
    let forty = "word ".repeat(40);
    let long = format!("/// {forty}");
    let rust = [
        "//! What a node has read. It is long.",
        "",
        "fn f() {} // Who waits here stands behind code.",
        "",
        "/// Sends a frame. Whoever reads",
        "/// it is awake: the latter sleeps.",
        "",
        "///",
        &long,
        &long,
        "",
        "// The frame is counted by whoever",
        "// sends it, e.g. the node.",
    ];
    let rust = rust.join("\n");
    assert_eq!(
        found("src/a.rs", &rust),
        [
            "src/a.rs:1: 'What': name the thing instead of a clause about it",
            "src/a.rs:5: 'Whoever': name the thing instead of a clause about it",
            "src/a.rs:6: 'the latter': name the thing again",
            "src/a.rs:9: a sentence of 80 words: split it (40 at most)",
            "src/a.rs:12: 'by whoever': name the thing instead of a clause about it",
        ]
    );
    let document = "# What holds\n\nWho asks? What is SM2? Nodes.\n\n\
                    ```\nWhat is code.\n```\n\n| Who | is a cell |\n\n\
                    1. It waits\n2. In vain. *That which* is new.\n";
    assert_eq!(
        found("a.md", document),
        [
            "a.md:12: 'in vain': state what did not happen",
            "a.md:12: 'That which': name the thing instead of a clause about it",
        ]
    );
    let clean = format!("/// Sends a frame. Wakes its receiver: {forty}\n//= SM2-TRN-001\n");
    assert_eq!(found("src/a.rs", &clean), Vec::<String>::new());
    let packages = [Path::new("sm2"), Path::new("")];
    let package = |path| prose::package_of(Path::new(path), |it| packages.contains(&it));
    assert_eq!(package("sm2/src/a.rs"), Path::new("sm2"));
    assert_eq!(package("docs/src/a.md"), Path::new("."));
}

#[test]
fn relative_clauses_behind_prepositions_are_found() {
    let text = "//! A socket on which a side\n//! listens, and the file in\n//! which it is.\n\n\
                // The order in which they came, and the one which it is; which of which is open.\n\
                let a = \"by which\"; // of which\n";
    let found = prose::chained_relatives(Path::new("src/a.rs"), text);
    let found: Vec<_> = found.iter().map(ToString::to_string).collect();
    assert_eq!(
        found,
        [
            "src/a.rs:1: 'on which'",
            "src/a.rs:2: 'in which'",
            "src/a.rs:5: 'of which'",
        ]
    );
}

#[test]
fn an_error_that_shows_its_source_is_found() {
    let shown = |text: &str| causes::shown_sources(Path::new("src/error.rs"), text).len();
    for error in [
        r#"enum E { #[error("no {}: {source}", path.display())] A { path: PathBuf, source: io::Error } }"#,
        r#"enum E { #[error("no: {source:?}")] A { source: io::Error } }"#,
        r#"enum E { #[error("no: {}", .source.message())] A { source: toml::Error } }"#,
        r#"enum E { #[error("no: {0}; look")] A(#[from] io::Error) }"#,
        r#"enum E { #[error("no: {}", text(.0))] A(#[source] io::Error) }"#,
        r#"enum E { #[error("{name}: {cause}")] A { name: Name, #[source] cause: io::Error } }"#,
        r#"#[error("no: {0}")] struct E(#[from] io::Error);"#,
    ] {
        assert_eq!(shown(error), 1, "{error}");
    }
    for error in [
        r#"enum E { #[error("no: {source}")] A { r#source: io::Error } }"#,
        r#"enum E { #[error("no descriptor")] A { source: io::Error } }"#,
        r#"enum E { #[error("no: {0}")] A(io::Error) }"#,
        r#"enum E { #[error("no {name}")] A { name: Name, #[source] cause: io::Error } }"#,
        r#"enum E { #[error(transparent)] A(#[from] io::Error) }"#,
    ] {
        assert_eq!(shown(error), 0, "{error}");
    }
}
