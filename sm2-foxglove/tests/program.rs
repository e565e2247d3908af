//! The program.

use std::io::{BufRead as _, BufReader, Read as _};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use nix::sys::signal::{Signal, kill};
use nix::unistd::Pid;
use sm2_test_support::{Scheduling, until};

use crate::common::{Viewer, World};

/// The program, with the socket of a Manager.
pub(crate) fn program(socket: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sm2-foxglove"));
    command.arg("--socket").arg(socket).env_remove("SM2_LOG");
    command
}

/// The program in a process, and its first line of output.
pub(crate) struct Process {
    pub(crate) child: Child,
    pub(crate) url: String,
}

impl Process {
    pub(crate) fn start(socket: &Path, arguments: &[&str]) -> Self {
        Self::spawn(program(socket).args(arguments))
    }

    fn spawn(command: &mut Command) -> Self {
        let command = command.args(["--listen", "127.0.0.1:0"]);
        let mut child = command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut url = String::new();
        BufReader::new(child.stdout.take().unwrap())
            .read_line(&mut url)
            .unwrap();
        Self {
            child,
            url: url.trim_end().to_owned(),
        }
    }

    /// Ends it with a signal. Returns what it has written to standard error.
    fn end(mut self, signal: Signal) -> String {
        let pid = Pid::from_raw(self.child.id().try_into().unwrap());
        kill(pid, signal).unwrap();
        let mut status = None;
        until("the program ends", || {
            status = self.child.try_wait().unwrap();
            status.is_some()
        });
        assert_eq!(status.unwrap().code(), Some(0));
        let mut text = String::new();
        let mut stderr = self.child.stderr.take().unwrap();
        stderr.read_to_string(&mut text).unwrap();
        text
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The only line on standard error.
fn line(output: &Output) -> String {
    let text = String::from_utf8(output.stderr.clone()).unwrap();
    assert_eq!(text.lines().count(), 1, "{text}");
    text.trim_end().to_owned()
}

#[test]
fn a_signal_ends_it_cleanly() {
    let world = World::new();
    let node = world.node("talker");
    let _publisher = node.publisher::<str>("chatter").unwrap();
    for signal in [Signal::SIGINT, Signal::SIGTERM] {
        let process = Process::start(&world.socket(), &["chatter", "absent"]);
        let mut viewer = Viewer::connect(&process.url);
        viewer.subscribe("chatter");
        let text = process.end(signal);
        let hint = "sm2-foxglove: no node publishes a topic absent now: it is shown when one does";
        assert!(text.contains(hint), "{text}");
        assert!(
            !text.contains("no node publishes a topic chatter"),
            "{text}"
        );
    }
}

#[test]
fn it_leaves_the_processor_to_others() {
    const NORMAL: u32 = 0;
    const IDLE: u32 = 5;
    let world = World::new();
    for (arguments, expected) in [(&[][..], IDLE), (&["--priority", "normal"][..], NORMAL)] {
        let process = Process::start(&world.socket(), arguments);
        let threads = Scheduling::of_process(process.child.id());
        assert!(
            threads.len() > 1 && threads.iter().all(|it| it.policy == expected),
            "{threads:?}"
        );
    }
}

#[test]
fn errors_are_one_line() {
    let world = World::new();
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let taken = taken.local_addr().unwrap().to_string();
    for (arguments, status, expected) in [
        (
            ["--listen", &taken],
            1,
            "sm2-foxglove: cannot listen on 127.0.0.1:",
        ),
        (
            ["--listen", "127.0.0.1:99999"],
            2,
            "sm2-foxglove: invalid value '127.0.0.1:99999' for '--listen <ADDRESS>'",
        ),
        (
            ["--viewer-budget-mib", "0"],
            2,
            "sm2-foxglove: invalid value '0'",
        ),
        (
            ["--listen=127.0.0.1:0", "a//b"],
            2,
            "sm2-foxglove: invalid value 'a//b' for '[TOPIC]...'",
        ),
        (
            ["--nonsense", "scan"],
            2,
            "sm2-foxglove: unexpected argument '--nonsense' found",
        ),
    ] {
        let output = program(&world.socket()).args(arguments).output().unwrap();
        let line = line(&output);
        assert_eq!(output.status.code(), Some(status), "{line}");
        assert!(line.starts_with(expected), "{line}");
        assert!(!line.contains("Usage:"), "{line}");
    }
    let absent = program(Path::new("/nonexistent/sock")).output().unwrap();
    let line = line(&absent);
    assert_eq!(absent.status.code(), Some(1));
    assert!(
        line.starts_with("sm2-foxglove: no Manager at \"/nonexistent/sock\""),
        "{line}"
    );
}

#[test]
fn the_log_has_the_level_of_the_variable_and_no_colours_in_a_file() {
    let world = World::new();
    let wrong = program(&world.socket()).env("SM2_LOG", "verbose").output();
    let wrong = wrong.unwrap();
    let line = line(&wrong);
    assert_eq!(wrong.status.code(), Some(2), "{line}");
    assert!(
        line.starts_with("sm2-foxglove: SM2_LOG is \"verbose\": use "),
        "{line}"
    );

    for (level, is_logged) in [("info", true), ("off", false)] {
        let process = Process::spawn(program(&world.socket()).env("SM2_LOG", level));
        let _viewer = Viewer::connect(&process.url);
        let text = process.end(Signal::SIGTERM);
        let has_line = text.contains("INFO") && text.contains("a viewer has gone");
        assert_eq!(has_line, is_logged, "{text}");
        assert!(!text.contains('\u{1b}'), "{text}");
    }
}
