//! PROPERTIES.md and the Kani harnesses name each other.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The harness of each row, by its full path.
fn named(table: &str) -> BTreeSet<String> {
    table
        .split('`')
        .filter(|word| word.starts_with("sm2_proto::") && !word.contains(' '))
        .map(str::to_owned)
        .collect()
}

/// The functions behind a `kani::proof` in a source, below the path of its module.
fn harnesses(source: &str, module: &str) -> BTreeSet<String> {
    let marker = "#[cfg_attr(kani, kani::proof)]";
    let name = |rest: &str| Some(rest.split_once("fn ")?.1.split_once('(')?.0.to_owned());
    source
        .split(marker)
        .skip(1)
        .filter_map(name)
        .map(|name| format!("{module}::{name}"))
        .collect()
}

/// All harnesses below a folder of sources.
fn below(folder: &Path, module: &str) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for entry in fs::read_dir(folder).expect("a folder") {
        let path: PathBuf = entry.expect("an entry").path();
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let module = match stem.as_ref() {
            "lib" | "mod" => module.to_owned(),
            stem => format!("{module}::{stem}"),
        };
        if path.is_dir() {
            found.extend(below(&path, &module));
        } else {
            found.extend(harnesses(
                &fs::read_to_string(&path).expect("text"),
                &module,
            ));
        }
    }
    found
}

#[test]
fn every_row_has_its_harness_and_every_harness_its_row() {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let table = fs::read_to_string(here.join("PROPERTIES.md")).expect("the table");
    let there = below(&here.join("../sm2-proto/src"), "sm2_proto");
    assert!(!there.is_empty());
    assert_eq!(named(&table), there);
}

#[test]
fn reads_names_from_tables_and_sources() {
    let table = "| X | … | `sm2_proto::a::one` | `cargo test` |";
    let source = "#[cfg_attr(kani, kani::proof)]\n#[cfg_attr(kani, kani::unwind(2))]\nfn two() {}";
    assert_eq!(
        named(table),
        BTreeSet::from(["sm2_proto::a::one".to_owned()])
    );
    assert_eq!(
        harnesses(source, "sm2_proto::a"),
        BTreeSet::from(["sm2_proto::a::two".to_owned()])
    );
}
