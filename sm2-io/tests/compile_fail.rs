//! Safe programs cannot get a reference to memory that another process can change or shrink.
//! `compile_fail/README.md` says how to update the expected errors.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The compiler that produced the recorded errors.
const RECORDED_WITH: &str = include_str!("compile_fail/COMPILER");

/// Returns the name and the version of this compiler, without the commit.
fn compiler() -> String {
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let output = Command::new(rustc).arg("--version").output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    text.split(' ').take(2).collect::<Vec<_>>().join(" ")
}

/// Copies the programs without the recorded errors. trybuild then only checks that each program is rejected.
fn without_errors() -> PathBuf {
    let copies = Path::new(env!("CARGO_TARGET_TMPDIR")).join("compile_fail");
    fs::create_dir_all(&copies).unwrap();
    for entry in fs::read_dir("tests/compile_fail").unwrap() {
        let path = entry.unwrap().path();
        if path.extension().is_some_and(|it| it == "rs") {
            fs::copy(&path, copies.join(path.file_name().unwrap())).unwrap();
        }
    }
    copies
}

#[test]
fn references_to_foreign_memory_do_not_compile() {
    let overwrite = std::env::var_os("TRYBUILD").is_some();
    let programs = match overwrite || compiler() == RECORDED_WITH.trim() {
        true => PathBuf::from("tests/compile_fail"),
        false => without_errors(),
    };
    let cases = trybuild::TestCases::new();
    cases.compile_fail(programs.join("*.rs").to_str().unwrap());
}
