//! Help and version.

use crate::common::{Running, sm2};

fn help(arguments: &[&str]) -> String {
    let help = Running::start(sm2(arguments).arg("--help")).finish();
    assert_eq!(help.code(), 0, "{}", help.stderr());
    help.stdout()
}

#[test]
fn help_mentions_every_command_and_examples() {
    let root = help(&[]);
    for command in [
        "manager",
        "topic",
        "node",
        "demo",
        "Examples:",
        "SM2_SOCKET",
        "Exit status",
    ] {
        assert!(root.contains(command), "{command} is not in\n{root}");
    }
    assert!(!root.contains("demo-part"), "{root}");
    let topic = help(&["topic"]);
    for command in ["pub", "echo", "list"] {
        assert!(topic.contains(command), "{topic}");
    }
    for (command, options) in [
        (
            &["topic", "pub"][..],
            &[
                "--from",
                "--lines",
                "--chunk",
                "--rate",
                "--loop",
                "--reliable",
                "--integrity",
                "--type",
            ][..],
        ),
        (
            &["topic", "echo"],
            &["--to-dir", "--count", "--reliable", "--json"],
        ),
        (&["topic", "list"], &["--json", "--domain", "--socket"]),
        (&["node", "list"], &["--json", "--domain", "--socket"]),
        (
            &["demo"],
            &[
                "--subscribers",
                "--size",
                "--rate",
                "--seconds",
                "--integrity",
                "--json",
            ],
        ),
        (&["manager"], &["--domain", "--socket"]),
    ] {
        let help = help(command);
        for option in options {
            assert!(help.contains(option), "{option} is not in\n{help}");
        }
    }
}

#[test]
fn no_command_shows_the_help() {
    for arguments in [&[][..], &["topic"], &["node"]] {
        let shown = Running::start(&mut sm2(arguments)).finish();
        assert_eq!(shown.code(), 2);
        assert!(shown.stderr().contains("Usage:"), "{}", shown.stderr());
    }
}

#[test]
fn the_version_is_the_packages() {
    let version = Running::start(&mut sm2(&["--version"])).finish();
    assert_eq!(
        version.stdout(),
        format!("sm2 {}\n", env!("CARGO_PKG_VERSION"))
    );
}
