//! Completions and manual pages.

use std::{
    fs,
    process::{Command, Stdio},
};

use sm2_test_support::skip_without;

use crate::common::{Finished, Running, files, sm2};

fn run(arguments: &[&str]) -> Finished {
    Running::start(&mut sm2(arguments)).finish()
}

#[test]
fn completions_know_every_command() {
    for shell in ["bash", "zsh", "fish"] {
        let script = run(&["completions", shell]);
        assert_eq!((script.code(), script.stderr()), (0, String::new()));
        let script = script.stdout();
        for word in [
            "manager",
            "topic",
            "hz",
            "service",
            "snapshot",
            "doctor",
            "wait-manager",
        ] {
            assert!(
                script.contains(word),
                "{word} is not in the script for {shell}"
            );
        }
    }
    let script = run(&["completions", "bash"]).stdout();
    assert!(!script.contains("demo-part") && !script.contains("demo__part"));
    run(&["completions", "tcsh"]).failed(2, &["bash", "zsh", "fish"]);
    run(&["completions"]).failed(2, &["SHELL"]);
}

#[test]
fn the_shells_take_the_completions() {
    for (shell, check) in [("bash", "-n"), ("zsh", "-n"), ("fish", "--no-execute")] {
        let folder = tempfile::tempdir().unwrap();
        let script = folder.path().join("script");
        fs::write(&script, run(&["completions", shell]).stdout()).unwrap();
        let mut command = Command::new(shell);
        match command
            .arg(check)
            .arg(&script)
            .stdin(Stdio::null())
            .output()
        {
            Ok(checked) => assert!(checked.status.success(), "{shell}: {checked:?}"),
            Err(error) => skip_without(shell, error),
        }
    }
}

#[test]
fn pages_are_printed_and_written() {
    let page = run(&["man"]);
    assert_eq!(page.code(), 0);
    let page = page.stdout();
    for part in [
        ".TH sm2 1",
        ".SH NAME",
        ".SH EXAMPLES",
        ".SH ENVIRONMENT",
        ".SH EXIT STATUS",
        "sm2\\-topic",
    ] {
        assert!(page.contains(part), "{part} is not in\n{page}");
    }
    let page = run(&["man", "topic", "hz"]).stdout();
    assert!(page.contains(".TH sm2-topic-hz 1"), "{page}");
    run(&["man", "topic", "hertz"]).failed(2, &["sm2 topic hertz"]);

    let folder = tempfile::tempdir().unwrap();
    let into = folder.path().join("man1");
    let written = run(&["man", "--dir", into.to_str().unwrap()]);
    assert_eq!(
        (written.code(), written.stdout()),
        (0, String::new()),
        "{written:?}"
    );
    let pages = files(&into);
    let names: Vec<_> = pages.iter().map(|(name, _)| name.as_str()).collect();
    for name in [
        "sm2.1",
        "sm2-topic.1",
        "sm2-topic-hz.1",
        "sm2-service-call.1",
        "sm2-manager.1",
    ] {
        assert!(names.contains(&name), "{name} is not in {names:?}");
    }
    assert!(
        !names
            .iter()
            .any(|name| name.contains("demo-part") || name.contains("help"))
    );
    for (name, page) in &pages {
        let page = String::from_utf8_lossy(page);
        assert!(
            page.contains(".SH EXAMPLES"),
            "{name} has no examples:\n{page}"
        );
        // No heading appears twice.
        for heading in page.lines().filter(|line| line.starts_with(".SH ")) {
            assert_eq!(
                page.matches(&format!("{heading}\n")).count(),
                1,
                "{name}: {heading}"
            );
        }
    }
    let file = folder.path().join("file");
    fs::write(&file, "").unwrap();
    run(&["man", "--dir", file.to_str().unwrap()]).failed(1, &["cannot create folder"]);
}
