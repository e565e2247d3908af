//! `sm2 play` by keys and by `sm2 play control`.

use std::{fs::File, io::Write, os::fd::OwnedFd, process::Stdio};

use nix::{
    pty::openpty,
    sys::{
        signal::Signal,
        termios::{LocalFlags, tcgetattr},
    },
};
use serde_json::Value;

use crate::{
    bag::publish_lines,
    common::{Domain, Finished, Running, until},
};

/// A domain, and a bag with ten messages of `chatter`.
fn recorded() -> (Domain, String) {
    recorded_lines(|number| format!("line {number}\n"))
}

/// The same with these messages.
fn recorded_lines(line: impl Fn(usize) -> String) -> (Domain, String) {
    let domain = Domain::new();
    let path = domain.path("talk.mcap").to_str().unwrap().to_owned();
    let recorder = domain.start(&["record", "chatter", "--reliable", "chatter", "-o", &path]);
    domain.wait_for("chatter", "subscribers", 1);
    publish_lines(&domain, &(0..10).map(line).collect::<String>());
    recorder.signal(Signal::SIGINT);
    assert_eq!(recorder.finish().code(), 0);
    (domain, path)
}

fn control(domain: &Domain, command: &[&str]) -> Finished {
    domain.run(&[&["play", "control", "--timeout", "60s"], command].concat())
}

/// The state of the player after a command.
fn status(domain: &Domain, command: &[&str]) -> Value {
    let finished = control(domain, &[command, &["--json"]].concat());
    assert_eq!(finished.code(), 0, "{command:?}: {finished:?}");
    serde_json::from_str(&finished.stdout()).unwrap()
}

#[test]
fn another_command_pauses_and_steps() {
    let (domain, bag) = recorded();
    let player = domain.start(&["play", &bag, "--paused", "--rate", "0", "--json"]);
    let before = status(&domain, &["pause"]);
    assert_eq!(
        before.to_string(),
        r#"{"messages":0,"paused":true,"rate":0.0,"time_ns":null}"#
    );
    for messages in 1..=2 {
        let after = status(&domain, &["step"]);
        assert_eq!(after["messages"], messages);
        assert_eq!(status(&domain, &["pause"]), after);
    }
    let rate = control(&domain, &["rate", "0.5"]);
    let text = rate.stdout();
    assert!(
        text.starts_with("paused at 20") && text.ends_with("Z, rate 0.5, 2 messages\n"),
        "{text}"
    );
    status(&domain, &["resume"]);
    let finished = player.finish();
    assert_eq!(finished.code(), 0, "{finished:?}");
    let report: Value = serde_json::from_str(&finished.stdout()).unwrap();
    assert_eq!(report["topics"][0]["messages"], 10);
}

#[test]
fn wrong_commands_are_told() {
    let (domain, bag) = recorded();
    let none = domain.run(&["play", "control", "pause", "--timeout", "100ms"]);
    none.failed(1, &["service play/control has no server"]);
    for wrong in [&["pause", "2"][..], &["rate"], &["rate", "-1"], &["stop"]] {
        let finished = control(&domain, wrong);
        assert_eq!(finished.code(), 2, "{finished:?}");
    }
    // The second message is due in some years.
    let service = ["--service", "replay"];
    let play = ["play", &bag, "--rate", "0.000000001"];
    let player = domain.start(&[&play[..], &service].concat());
    let step = control(&domain, &[&["step"][..], &service].concat());
    step.failed(1, &["the replay is not paused"]);
    player.signal(Signal::SIGINT);
    let finished = player.finish();
    assert_eq!(finished.code(), 130, "{finished:?}");
}

/// `sm2 play` with a terminal as its standard input.
struct OnTerminal {
    player: Running,
    person: File,
    terminal: OwnedFd,
}

impl OnTerminal {
    fn start(domain: &Domain, arguments: &[&str]) -> Self {
        let pty = openpty(None, None).unwrap();
        let mut command = domain.command(arguments);
        command.stdin(Stdio::from(pty.slave.try_clone().unwrap()));
        Self {
            player: Running::start(&mut command),
            person: pty.master.into(),
            terminal: pty.slave,
        }
    }

    fn press(&mut self, keys: &str) {
        self.person.write_all(keys.as_bytes()).unwrap();
    }

    /// Whether the terminal edits lines and echoes, as a shell needs it.
    fn is_restored(&self) -> bool {
        let flags = tcgetattr(&self.terminal).unwrap().local_flags;
        flags.contains(LocalFlags::ICANON | LocalFlags::ECHO)
    }
}

#[test]
fn keys_control_a_replay() {
    let (domain, bag) = recorded();
    let arguments = ["play", &bag, "--paused", "--loop", "--rate", "0.000000001"];
    let mut on = OnTerminal::start(&domain, &arguments);
    on.player.await_stderr("keys: space pauses");
    until("the mode of the terminal is set", || !on.is_restored());
    on.press("s\x1b[Cxs");
    until("three messages are published", || {
        status(&domain, &["pause"])["messages"] == 3
    });
    on.press("+");
    on.player.await_stderr(", rate 0.000000002, 3 messages");
    on.press("--");
    on.player.await_stderr(", rate 0.0000000005, 3 messages");
    on.press(" ");
    on.player.await_stderr("playing at ");
    assert_eq!(status(&domain, &["rate", "1e-9"])["paused"], false);
    on.press(" ");
    until("it is paused", || {
        on.player.stderr().matches("paused at ").count() == 4
    });
    on.press("q");
    let OnTerminal {
        player,
        person,
        terminal,
    } = on;
    let finished = player.finish();
    assert_eq!(finished.code(), 0, "{finished:?}");
    assert!(
        finished.stdout().starts_with("chatter: 3 messages"),
        "{finished:?}"
    );
    let flags = tcgetattr(&terminal).unwrap().local_flags;
    assert!(flags.contains(LocalFlags::ICANON | LocalFlags::ECHO));
    drop(person);
}

#[test]
fn the_terminal_is_restored_after_a_signal_and_an_error() {
    let (domain, bag) = recorded();
    let arguments = ["play", &bag, "--paused"];
    for signal in [Signal::SIGINT, Signal::SIGTERM] {
        let mut on = OnTerminal::start(&domain, &arguments);
        until("the mode of the terminal is set", || !on.is_restored());
        on.player.signal(signal);
        until("the player ends", || {
            on.player.child().try_wait().unwrap().is_some()
        });
        assert!(on.is_restored(), "{signal}");
    }
    // The bag, with a chunk for each message, is gone behind the player's back.
    let (domain, bag) = recorded_lines(|_| "x".repeat(100_000) + "\n");
    let arguments = ["play", &bag, "--paused"];
    let mut on = OnTerminal::start(&domain, &arguments);
    until("the mode of the terminal is set", || !on.is_restored());
    assert_eq!(status(&domain, &["pause"])["messages"], 0);
    std::fs::write(&bag, "").unwrap();
    on.press("ssssssssssss");
    on.player
        .await_stderr("a damaged part of the bag is left out");
    until("the player ends", || {
        on.player.child().try_wait().unwrap().is_some()
    });
    assert!(on.is_restored());
}

#[test]
fn a_replay_with_json_leaves_the_terminal_alone() {
    let (domain, bag) = recorded();
    let arguments = ["play", &bag, "--rate", "0", "--paused", "--json"];
    let mut on = OnTerminal::start(&domain, &arguments);
    on.press("q ");
    assert_eq!(status(&domain, &["step"])["messages"], 1);
    assert!(on.is_restored());
    on.player.signal(Signal::SIGTERM);
    let finished = on.player.finish();
    assert_eq!(finished.code(), 143, "{finished:?}");
    assert!(!finished.stderr().contains("keys"), "{finished:?}");
}
