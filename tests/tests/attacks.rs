//! The command that measures processes beside attacks runs.

use std::process::{Command, Stdio};

/// The length of a window.
const SECONDS: &str = if cfg!(feature = "slow") { "1" } else { "0.1" };

/// The figures are for a quiet machine and an optimised build, so only their presence is tested.
#[test]
fn the_attacks_can_be_measured() {
    let attack = "two subscribers that never release a message";
    let output = Command::new(env!("CARGO_BIN_EXE_attacks"))
        .args(["--seconds", SECONDS, "--repeats", "1", "--only", attack])
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    let row = text.lines().find(|it| it.contains(attack));
    let errors = String::from_utf8_lossy(&output.stderr);
    let cells = row.map(|it| it.matches(" → ").count());
    assert_eq!(cells, Some(4), "{text}{errors}");
}
