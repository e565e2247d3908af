//! The output of commands on a terminal: colours, progress, and the order of lines.

use std::{
    fs::File,
    io::Read,
    process::Stdio,
    sync::{Arc, Mutex},
    thread,
};

use nix::{pty::openpty, sys::signal::Signal};
use serde_json::Value;

use crate::{
    bag::publish_lines,
    common::{Domain, Running, until},
};

/// The output of a command on a terminal, as far as it has come.
#[derive(Clone, Default)]
struct Shown(Arc<Mutex<Vec<u8>>>);

impl Shown {
    fn text(&self) -> String {
        String::from_utf8_lossy(&self.0.lock().unwrap()).into_owned()
    }
}

/// Starts a command whose standard output and standard error are a terminal.
fn start(domain: &Domain, arguments: &[&str], variable: Option<&str>) -> (Running, Shown) {
    let pty = openpty(None, None).unwrap();
    let mut command = domain.command(arguments);
    command.env("TERM", "xterm").env_remove("NO_COLOR");
    command.envs(variable.map(|it| (it, "1")));
    let terminal = || Stdio::from(pty.slave.try_clone().unwrap());
    command.stdout(terminal()).stderr(terminal());
    let running = Running::start_elsewhere(&mut command);
    // The command object has copies of the terminal, and so has this function: the reader waits for the end of all.
    drop(command);
    let shown = Shown::default();
    let (into, mut from) = (shown.clone(), File::from(pty.master));
    thread::spawn(move || {
        let mut buffer = [0; 4_096];
        // At the end of what a closed terminal has shown is an error.
        while let Ok(len @ 1..) = from.read(&mut buffer) {
            into.0.lock().unwrap().extend_from_slice(&buffer[..len]);
        }
    });
    (running, shown)
}

/// The output of a command on a terminal, which ends by itself.
fn shown(domain: &Domain, arguments: &[&str], variable: Option<&str>, last: &str) -> String {
    let (mut running, shown) = start(domain, arguments, variable);
    until("the command ends", || {
        running.child().try_wait().unwrap().is_some()
    });
    until("its output is read", || shown.text().contains(last));
    shown.text()
}

#[test]
fn colours_are_for_terminals_of_people_who_want_them() {
    let domain = Domain::new();
    let on_terminal = |variable| shown(&domain, &["doctor"], variable, "socket queues");
    let doctor = on_terminal(None);
    assert!(doctor.contains("\x1b[32mok\x1b[0m"), "{doctor}");
    assert!(doctor.contains("\x1b[33mwarn\x1b[0m"), "{doctor}");
    let plain = on_terminal(Some("NO_COLOR"));
    assert!(!plain.contains('\x1b'), "{plain}");
    let piped = domain.run(&["doctor"]).stdout();
    assert!(
        piped.contains("socket queues") && !piped.contains('\x1b'),
        "{piped}"
    );

    let node = domain.node("driver");
    let _publisher = node.publisher::<str>("scan").unwrap();
    let _other = node.publisher::<str>("other").unwrap();
    let why = shown(
        &domain,
        &["why", "driver:scan", "driver:other"],
        None,
        "only",
    );
    assert!(why.starts_with("\x1b[31m"), "{why}");
    let wrong = shown(&domain, &["topic", "info", "none"], None, "none");
    assert!(
        wrong.starts_with("\x1b[31msm2:\x1b[0m this domain"),
        "{wrong}"
    );
}

#[test]
fn a_small_screen_has_first_what_matters() {
    let domain = Domain::with(&["--interfaces-per-session", "5"]);
    let node = domain.node("busy");
    let topic = |name| node.publisher::<str>(name).unwrap();
    let mut publishers = vec![topic("a")];
    // No Manager stands by, which is a warning.
    let doctor = domain.run(&["doctor"]).stdout();
    let mut levels = doctor
        .lines()
        .skip(1)
        .map(|it| it.split(' ').next().unwrap());
    assert_eq!(levels.next(), Some("warn"), "{doctor}");
    assert_eq!(levels.find(|it| *it == "ok"), Some("ok"), "{doctor}");
    assert_eq!(levels.find(|it| *it != "ok"), None, "{doctor}");
    let snapshot = domain.run(&["snapshot"]).stdout();
    for text in [&doctor, &snapshot] {
        assert!(!text.contains("LIMIT"), "{text}");
    }
    // Four of five are 80 %.
    publishers.extend(["b", "c", "d"].map(topic));
    for command in ["doctor", "snapshot"] {
        let text = domain.run(&[command]).stdout();
        let (_, limits) = text.split_once("\nLIMIT ").unwrap();
        let rows: Vec<_> = limits.lines().skip(1).collect();
        assert_eq!(rows.len(), 1, "{text}");
        assert!(rows[0].starts_with("interfaces_per_session"), "{text}");
    }
    let document = domain.json(&["snapshot"]);
    assert!(document["limits"].as_object().unwrap().len() > 1);
}

#[test]
fn a_replay_shows_its_progress_in_one_line() {
    let domain = Domain::new();
    let path = domain.path("talk.mcap").to_str().unwrap().to_owned();
    let recorder = domain.start(&["record", "chatter", "--reliable", "chatter", "-o", &path]);
    domain.wait_for("chatter", "subscribers", 1);
    publish_lines(&domain, "one\n");
    recorder.signal(Signal::SIGINT);
    assert_eq!(recorder.finish().code(), 0);
    let (player, shown) = start(&domain, &["play", &path, "--paused"], None);
    until("the progress is shown", || {
        shown
            .text()
            .contains("\r\x1b[2K0.0 of 0.0 s (100 %), 0 messages, paused")
    });
    until("it is written anew", || {
        shown.text().matches("0 messages, paused").count() > 1
    });
    assert!(!shown.text().contains("paused\r\n"), "{}", shown.text());
    player.signal(Signal::SIGINT);
    assert_eq!(player.finish().code(), 130);
    let piped = domain.run(&["play", &path, "--rate", "0"]);
    assert!(!piped.stderr().contains(" of "), "{piped:?}");
}

#[test]
fn the_counts_of_a_publisher_are_an_object() {
    let domain = Domain::new();
    let publish = [
        "topic", "pub", "n", "--value", "7", "--type", "u64", "--wait", "0", "--json",
    ];
    let finished = domain.run(&publish);
    assert_eq!((finished.code(), finished.stderr()), (0, String::new()));
    let counts: Value = serde_json::from_str(&finished.stdout()).unwrap();
    assert_eq!(
        (&counts["messages"], &counts["unheard"]),
        (&1.into(), &1.into())
    );
    assert_eq!(counts["counters"]["offered"], 0);
}
