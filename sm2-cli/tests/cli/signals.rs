//! Ctrl-C, SIGTERM, a reader that ends, and a parent that is killed.

use std::{
    fs,
    io::{BufRead, BufReader, Write},
    path::PathBuf,
    process::{Command, Stdio},
    thread,
};

use crate::common::{Domain, Running, SOON, sm2, until};
use nix::sys::signal::Signal;
use tempfile::TempDir;

#[test]
fn an_echo_without_end_is_ended_by_a_signal() {
    for signal in [Signal::SIGINT, Signal::SIGTERM] {
        let domain = Domain::new();
        let echo = domain.start(&["topic", "echo", "a"]);
        domain.wait_for("a", "subscribers", 1);
        echo.signal(signal);
        let echo = echo.finish();
        assert_eq!(echo.code(), 0);
        // A slow machine says before that it waits for a publisher.
        let errors = echo.stderr();
        assert!(
            errors.ends_with("received 0 messages (0 bytes), lost 0\n"),
            "{errors}"
        );
    }
}

#[test]
fn what_is_stopped_before_its_end_says_so_by_its_status() {
    let domain = Domain::new();
    let file = domain.path("file");
    fs::write(&file, "message").unwrap();
    let from = file.to_str().unwrap();

    let counting = domain.start(&["topic", "echo", "a", "--count", "1"]);
    domain.wait_for("a", "subscribers", 1);
    counting.signal(Signal::SIGINT);
    assert_eq!(counting.finish().code(), 130);

    let waiting = domain.start(&["topic", "pub", "b", "--from", from]);
    domain.wait_for("b", "publishers", 1);
    waiting.signal(Signal::SIGTERM);
    assert_eq!(waiting.finish().code(), 143);

    // Ctrl-C is the regular end of these.
    let looping = [
        "topic", "pub", "c", "--from", from, "--loop", "--wait", "0", "--rate", "1",
    ];
    let looping = domain.start(&looping);
    domain.wait_for("c", "publishers", 1);
    looping.signal(Signal::SIGINT);
    assert_eq!(looping.finish().code(), 0);
}

#[test]
fn reading_from_a_person_can_be_stopped() {
    let domain = Domain::new();
    let mut command = domain.command(&["topic", "pub", "a", "--from", "-", "--wait", "0"]);
    let mut publish = Running::start(command.stdin(Stdio::piped()));
    let stdin = publish.child().stdin.take();
    domain.wait_for("a", "publishers", 1);
    publish.signal(Signal::SIGINT);
    assert_eq!(publish.finish().code(), 130);
    drop(stdin);
}

#[test]
fn a_publisher_that_waits_for_a_stopped_subscriber_can_be_stopped() {
    let domain = Domain::new();
    let echo = domain.start(&["topic", "echo", "a", "--reliable"]);
    let mut command = domain.command(&["topic", "pub", "a", "--from", "-", "--reliable"]);
    let mut publish = Running::start(command.stdin(Stdio::piped()));
    let mut stdin = publish.child().stdin.take().unwrap();
    stdin.write_all(b"first\n").unwrap();
    until("the link is open", || echo.stdout() == "first\n");
    echo.signal(Signal::SIGSTOP);
    let writer = thread::spawn(move || stdin.write_all(&b"more\n".repeat(1_000_000)));
    publish.signal(Signal::SIGINT);
    let publish = publish.finish();
    assert_eq!(publish.code(), 130, "{}", publish.stderr());
    // The command ended without reading all input.
    assert!(writer.join().unwrap().is_err());
    echo.signal(Signal::SIGCONT);
}

#[test]
fn the_end_of_the_reader_is_a_quiet_end() {
    let domain = Domain::new();
    let mut command = domain.command(&["topic", "echo", "a"]);
    let mut echo = command
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut stdout = BufReader::new(echo.stdout.take().unwrap());
    let file = domain.path("file");
    fs::write(&file, "first").unwrap();
    domain.run(&["topic", "pub", "a", "--from", file.to_str().unwrap()]);
    let mut line = String::new();
    stdout.read_line(&mut line).unwrap();
    assert_eq!(line, "first\n");
    // The command notices without another message.
    drop(stdout);
    until("echo ends", || echo.try_wait().unwrap().is_some());
    assert_eq!(echo.wait().unwrap().code(), Some(0));
}

/// The processes whose parent is `pid`.
fn children(pid: i32) -> Vec<i32> {
    let processes = fs::read_dir("/proc").unwrap().flatten();
    let pids = processes.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    pids.filter(|&it| parent(it) == Some(pid)).collect()
}

/// `None` if the process is gone or a zombie.
fn parent(pid: i32) -> Option<i32> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    let (_, fields) = stat.rsplit_once(") ")?;
    let mut fields = fields.split(' ');
    (fields.next()? != "Z").then_some(fields.next()?.parse().ok()?)
}

/// A running demo, its processes, and its folder for temporary files.
fn started_demo() -> (Running, Vec<i32>, TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let demo = [
        "demo",
        "--subscribers",
        "2",
        "--size",
        "64kB",
        "--seconds",
        "100",
    ];
    let demo = Running::start(sm2(&demo).env("TMPDIR", folder.path()));
    // The demo prints a line each second.
    until("the demo runs", || demo.stdout().lines().count() > 1);
    let parts = children(demo.pid());
    assert_eq!(parts.len(), 3);
    (demo, parts, folder)
}

#[test]
fn a_demo_that_is_stopped_reports_what_it_has() {
    let (demo, parts, _folder) = started_demo();
    demo.signal(Signal::SIGINT);
    let demo = demo.finish();
    assert_eq!(demo.code(), 130, "{}", demo.stderr());
    assert!(
        demo.stdout()
            .lines()
            .last()
            .unwrap()
            .contains("messages of 64 kB"),
        "{demo:?}"
    );
    assert!(parts.iter().all(|&pid| parent(pid).is_none()));
}

#[test]
fn a_demo_that_is_killed_takes_its_processes_along() {
    let (demo, parts, folder) = started_demo();
    demo.signal(Signal::SIGKILL);
    demo.finish();
    until("its processes are gone", || {
        parts.iter().all(|&pid| parent(pid).is_none())
    });
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn a_demo_that_loses_a_process_says_which() {
    let (demo, parts, _folder) = started_demo();
    let subscriber = |pid: &&i32| {
        let arguments = fs::read(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        String::from_utf8_lossy(&arguments).contains("subscriber-2")
    };
    let victim = *parts.iter().find(subscriber).unwrap();
    nix::sys::signal::kill(nix::unistd::Pid::from_raw(victim), Signal::SIGKILL).unwrap();
    until("it is gone", || parent(victim).is_none());
    demo.signal(Signal::SIGTERM);
    demo.finish().failed(1, &["subscriber 2", "signal: 9"]);
}

/// A terminal that is closed, or a script that asks for a snapshot, must not cost the end of a bag.
#[test]
fn signals_end_a_recording_in_order() {
    let domain = Domain::new();
    let recorder = |name: &str, before: &str| {
        let bag = domain.path(name);
        // Under nohup, the tests inherit that SIGHUP is ignored, and no shell can take that back.
        let mut command = Command::new("env");
        let script = format!("{before} exec \"$0\" \"$@\"");
        command.args([
            "--default-signal=HUP",
            "sh",
            "-c",
            &script,
            env!("CARGO_BIN_EXE_sm2"),
            "record",
            "--all",
            "-o",
        ]);
        command
            .arg(&bag)
            .arg("--socket")
            .arg(domain.path("sm2.sock"));
        let running = Running::start(&mut command);
        running.await_stderr("recording to");
        (running, bag)
    };
    let ends = |(running, bag): (Running, PathBuf)| {
        let finished = running.finish();
        assert_eq!(finished.code(), 0, "{finished:?}");
        let checked = sm2(&["bag", "check"]).arg(bag).output().unwrap();
        assert!(checked.status.success(), "{checked:?}");
    };
    for signal in [Signal::SIGHUP, Signal::SIGUSR1] {
        let recorder = recorder(signal.as_str(), "");
        recorder.0.signal(signal);
        ends(recorder);
    }
    // As nohup does.
    let recorder = recorder("ignored", "trap '' HUP;");
    recorder.0.signal(Signal::SIGHUP);
    recorder.0.signal(Signal::SIGUSR1);
    ends(recorder);
}

#[test]
fn a_limit_of_the_length_of_files_is_an_error() {
    let domain = Domain::new();
    let bag = domain.path("bag");
    let script = "ulimit -f 1; exec \"$0\" \"$@\"";
    let mut command = Command::new("sh");
    command.args(["-c", script, env!("CARGO_BIN_EXE_sm2"), "record", "--all"]);
    command.args(["--sync", "1ms", "-o"]).arg(&bag);
    let recorder = Running::start(command.arg("--socket").arg(domain.path("sm2.sock")));
    recorder.await_stderr("recording to");
    let node = domain.node("talker");
    let publisher = node.publisher::<[u8]>("data").unwrap();
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    publisher.publish(&[1; 10_000]).unwrap();
    let before = format!("recording to {} (Ctrl-C ends)\n", bag.display());
    let parts = ["cannot write the bag", "File too large"];
    recorder.finish().failed_after(1, &before, &parts);
}

#[test]
fn a_bag_does_not_go_to_standard_output() {
    let finished = Running::start(&mut sm2(&["record", "--all", "-o", "-"])).finish();
    finished.failed(2, &["standard output"]);
}

#[test]
fn a_wrong_level_of_the_log_is_named() {
    for arguments in [
        &["topic", "list"][..],
        &["manager", "--socket", "/nowhere/sm2.sock"],
        &["gateway", "check", "/nowhere.toml"],
    ] {
        let finished = Running::start(sm2(arguments).env("SM2_LOG", "verbose")).finish();
        finished.failed(2, &["SM2_LOG", "verbose", "debug"]);
    }
}
