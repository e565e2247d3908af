//! Tests that need a process of their own: they count its descriptors, lower its limits, or change its signals.

use std::{env, process::Command};

/// Names the test that the process was started for.
const TEST: &str = "SM2_TEST_OF_THIS_PROCESS";

/// Runs the calling test in a process of its own. Returns true in the process that waited for it, whose test is then
/// over, and false in the new process. `path` is `concat!(module_path!(), "::NAME")`.
///
/// # Panics
///
/// The test fails in its process, or there is no test with this path.
#[must_use]
pub fn ran_alone(path: &str) -> bool {
    if env::var_os(TEST).is_some_and(|it| it == path) {
        return false;
    }
    let (_, name) = path
        .split_once("::")
        .expect("a path with the name of the crate");
    let mut command = Command::new(env::current_exe().unwrap());
    command
        .args(["--exact", name, "--nocapture"])
        .env(TEST, path);
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{}\n{said}{errors}", output.status);
    // A name that is misspelt would run nothing.
    assert!(said.contains("test result: ok. 1 passed"), "{said}{errors}");
    print!("{said}");
    eprint!("{errors}");
    true
}
