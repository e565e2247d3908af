//! Help and version.

use crate::common::{Running, sm2};

/// The text of a command's `--help`.
pub(crate) fn help(arguments: &[&str]) -> String {
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

/// The subcommands that a help text lists, without `help`.
pub(crate) fn commands(help: &str) -> Vec<&str> {
    let listed = help.split("Commands:\n").nth(1).unwrap_or_default();
    let lines = listed.lines().take_while(|line| line.starts_with("  "));
    let names = lines.filter_map(|line| line.split_whitespace().next());
    names.filter(|name| *name != "help").collect()
}

/// Every command has examples that start with the command.
#[test]
fn every_command_has_examples() {
    fn check(path: &mut Vec<String>, seen: &mut usize) {
        let words: Vec<_> = path.iter().map(String::as_str).collect();
        let help = help(&words);
        let (_, examples) = help.split_once("Examples:\n").unwrap_or_else(|| {
            panic!("{path:?} has no examples:\n{help}");
        });
        let full = format!("sm2 {}", words.join(" "));
        assert!(examples.contains(full.trim_end()), "{full}:\n{help}");
        // Hand-written lines fit a terminal of 110 columns.
        assert!(
            examples.lines().all(|line| line.chars().count() <= 110),
            "{help}"
        );
        let children: Vec<_> = commands(&help).into_iter().map(str::to_owned).collect();
        for child in children {
            path.push(child);
            check(path, seen);
            path.pop();
        }
        *seen += 1;
    }
    let mut seen = 0;
    check(&mut Vec::new(), &mut seen);
    assert!(seen >= 26, "{seen} commands");
}

#[test]
fn what_prints_data_prints_json() {
    for command in [
        "topic list",
        "topic info",
        "topic echo",
        "topic hz",
        "topic bw",
        "topic delay",
        "topic loss",
        "service list",
        "service info",
        "service call",
        "node list",
        "node info",
        "param list",
        "param get",
        "param set",
        "param describe",
        "param dump",
        "param load",
        "param watch",
        "snapshot",
        "wait",
        "why",
        "top",
        "doctor",
        "up",
        "demo",
    ] {
        let words: Vec<_> = command.split(' ').collect();
        let help = help(&words);
        assert!(help.contains("--json"), "{command}:\n{help}");
        if command != "demo" {
            for option in [
                "--domain",
                "--socket",
                "--connect-timeout",
                "--wait-manager",
            ] {
                assert!(help.contains(option), "{command} has no {option}");
            }
        }
    }
}

#[test]
fn no_command_shows_the_help() {
    for arguments in [&[][..], &["topic"], &["node"], &["service"], &["param"]] {
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
