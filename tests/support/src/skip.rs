//! Tests that cannot run on this machine.

use std::{env, fmt::Display, fs::OpenOptions, io::Write as _, thread};

/// The file where `.ci/run` lets tests write that they were skipped.
const LIST: &str = "SM2_SKIPPED";
/// The programs that `.ci/run` has installed, separated by spaces.
const INSTALLED: &str = "SM2_INSTALLED";

/// Reports that the calling test is skipped, because this machine lacks something other than a program: a right, or a
/// feature of its kernel. The test must return then.
///
/// # Panics
///
/// The list of skipped tests cannot be written.
pub fn skip(reason: impl Display) {
    let test = thread::current();
    let test = test.name().unwrap_or("a test");
    println!("skipped: {reason}");
    let Some(path) = env::var_os(LIST) else {
        return;
    };
    let file = OpenOptions::new().create(true).append(true).open(path);
    // One write: tests of several processes share the file.
    let line = format!("{test}: {reason}\n");
    file.and_then(|mut file| file.write_all(line.as_bytes()))
        .expect(LIST);
}

/// Reports that the calling test is skipped, because this machine lacks a program. The test must return then.
///
/// # Panics
///
/// `.ci/run` has installed that program: then its tests have to run.
pub fn skip_without(program: &str, reason: impl Display) {
    let installed = env::var(INSTALLED).unwrap_or_default();
    assert!(
        !installed.split_whitespace().any(|it| it == program),
        "{program} is installed, but cannot be used: {reason}"
    );
    skip(format_args!("{program}: {reason}"));
}
