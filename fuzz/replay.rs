//! Seeds and findings through the body of a fuzz target: for the tests of the crates.
#![allow(dead_code, reason = "each test uses a part")]

use std::{
    fs,
    path::{Path, PathBuf},
};

/// Every input of `fuzz/corpus/TARGET/`, at least one, and of
/// `fuzz/regressions/TARGET/`. Panics as the body does; the last name printed is the input's.
pub(crate) fn replay(target: &str, body: impl Fn(&[u8])) {
    let seeds = entries(&folder("corpus").join(target));
    assert!(!seeds.is_empty(), "{target} has seeds");
    let findings = folder("regressions").join(target);
    let findings = if findings.exists() {
        entries(&findings)
    } else {
        Vec::new()
    };
    for input in seeds.iter().chain(&findings) {
        println!("{}", input.display());
        body(&fs::read(input).expect("readable"));
    }
    println!("{target}: {} inputs", seeds.len() + findings.len());
}

/// The targets, by name.
pub(crate) fn targets() -> Vec<String> {
    let shims = entries(&folder("fuzz_targets"));
    let name = |path: &PathBuf| path.file_stem().map(|name| name.to_string_lossy().into());
    shims.iter().filter_map(name).collect()
}

/// The targets that have seeds.
pub(crate) fn corpora() -> Vec<String> {
    let corpora = entries(&folder("corpus"));
    let name = |path: &PathBuf| path.file_name().map(|name| name.to_string_lossy().into());
    corpora.iter().filter_map(name).collect()
}

fn folder(name: &str) -> PathBuf {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    package.join("../fuzz").join(name)
}

/// Sorted, so that every run has the same order.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let read = fs::read_dir(folder).unwrap_or_else(|error| panic!("{folder:?}: {error}"));
    let mut entries: Vec<_> = read.map(|entry| entry.expect("readable").path()).collect();
    entries.sort();
    entries
}
