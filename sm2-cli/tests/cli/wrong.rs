//! Bad input and failing systems: each error is one line with a remedy, and has the right exit status.

use std::{
    fs::{self, File},
    path::Path,
    process::{Command, Stdio},
};

use nix::sys::signal::Signal;
use sm2_test_support::skip;

use crate::common::{Domain, Finished, Running, files, noise, sm2, talker, until};

fn run(arguments: &[&str]) -> Finished {
    Running::start(&mut sm2(arguments)).finish()
}

#[test]
fn no_manager_is_told_with_its_socket_and_the_cure() {
    let folder = tempfile::tempdir().unwrap();
    let socket = folder.path().join("none.sock");
    let socket = socket.to_str().unwrap();
    let start = format!("start one with `sm2 manager --socket {socket}`");
    for command in [
        &["topic", "list"][..],
        &["topic", "info", "a"],
        &["topic", "echo", "a"],
        &["topic", "pub", "a", "--from", "/dev/null"],
        &["topic", "hz", "a"],
        &["topic", "bw", "a"],
        &["topic", "delay", "a"],
        &["topic", "loss", "a"],
        &["service", "list"],
        &["service", "info", "a"],
        &["service", "call", "a"],
        &["node", "list"],
        &["node", "info", "a"],
        &["snapshot"],
        &["snapshot", "--watch"],
        &["wait", "node:a"],
        &["why", "a"],
        &["top", "--once"],
    ] {
        let finished = run(&[command, &["--socket", socket]].concat());
        finished.failed(1, &["no Manager answers at", socket, &start]);
    }

    let mut named = sm2(&["topic", "list", "--domain", "robot-1"]);
    let named = Running::start(named.env("XDG_RUNTIME_DIR", folder.path())).finish();
    named.failed(1, &["sm2/robot-1.sock", "`sm2 manager --domain robot-1`"]);

    // A Manager that was killed leaves its socket.
    let listener = std::os::unix::net::UnixListener::bind(socket).unwrap();
    drop(listener);
    run(&["node", "list", "--socket", socket]).failed(1, &["sm2: ", socket]);
}

#[test]
fn bad_names_show_the_grammar() {
    let grammar = "segments of A-Z a-z 0-9 _ - joined by single /, at most 255 bytes";
    let long = "x".repeat(256);
    for name in ["two words", "", "a//b", "//a", "a/", "ünïcode", &long] {
        run(&["topic", "echo", name])
            .failed(2, &["invalid value", grammar, "sm2 topic echo --help"]);
        let publish = ["topic", "pub", name, "--from", "-"];
        run(&publish).failed(2, &["invalid value", grammar]);
    }
    run(&["topic", "pub", "a", "--from", "-", "--type", "a b"]).failed(2, &[grammar]);
    run(&["topic", "pub", "a", "--from", "-", "--type", "a:xyz"]).failed(2, &["16 hex digits"]);
    run(&["topic", "list", "--domain", "no/slash"]).failed(2, &["no/slash"]);
}

#[test]
fn wrong_usage_is_one_line_and_status_2() {
    for (arguments, parts) in [
        (&["topic", "pub", "a"][..], &["--from"][..]),
        (
            &["topic", "pub", "a", "--from", ""],
            &["--from", "standard input"],
        ),
        (
            &["topic", "pub", "a", "--from", "-", "--rate", "0"],
            &["--rate", "above 0"],
        ),
        (
            &["topic", "pub", "a", "--from", "-", "--chunk", "0"],
            &["--chunk", "1 byte"],
        ),
        (
            &["topic", "pub", "a", "--from", "-", "--chunk", "9 parsecs"],
            &["such as 10MB"],
        ),
        (
            &["topic", "pub", "a", "--from", "-", "--chunk", "8GiB"],
            &["at most 4"],
        ),
        (
            &[
                "topic", "pub", "a", "--from", "-", "--chunk", "8", "--lines",
            ],
            &["--lines"],
        ),
        (
            &["topic", "pub", "a", "--from", "-", "--loop"],
            &["standard input", "a file or folder"],
        ),
        (
            &["topic", "pub", "a", "--from", "-", "--integrity", "none"],
            &["pooled", "sealed"],
        ),
        (&["topic", "echo", "a", "--count", "0"], &["--count"]),
        (
            &["topic", "echo", "a", "--domain", "b", "--socket", "c"],
            &["--domain", "--socket"],
        ),
        (&["topic", "ecko", "a"], &["echo"]),
        (&["demo", "--subscribers", "0"], &["--subscribers"]),
        (&["demo", "--size", "8"], &["--size", "16 bytes"]),
        (&["demo", "--seconds", "-1"], &["--seconds"]),
        (
            &["demo", "--rate", "100000", "--seconds", "100"],
            &["--rate", "1000000 is the most"],
        ),
    ] {
        run(arguments).failed(2, parts);
    }
}

#[test]
fn a_topic_of_another_type_names_both() {
    let domain = Domain::new();
    let first = ["topic", "pub", "imu", "--from", "/dev/null", "--wait", "1"];
    let _first = domain.start(&[&first[..], &["--type", "sensor/Imu:ab"]].concat());
    domain.wait_for("imu", "publishers", 1);
    let wrong = domain.run(&first);
    wrong.failed(
        1,
        &["topic imu", "sensor/Imu (schema 00000000000000ab)", "bytes"],
    );
    // A type without a hash is the topic's type of the same name.
    let hashless = [&first[..5], &["--type", "sensor/Imu", "--wait", "0"]].concat();
    assert_eq!(domain.run(&hashless).code(), 0);
}

#[test]
fn a_used_up_quota_is_named() {
    let domain = Domain::with(&["--interfaces-per-user", "1"]);
    let _first = domain.start(&["topic", "echo", "a"]);
    domain.wait_for("a", "subscribers", 1);
    let echo = domain.run(&["topic", "echo", "a"]);
    echo.failed(
        1,
        &[
            "quota of 1 interfaces per user",
            "raise interfaces_per_user of the Manager",
        ],
    );

    let domain = Domain::with(&["--sessions-per-user", "1"]);
    let first = domain.start(&["topic", "echo", "a"]);
    until("the first waits", || first.stderr().contains("waiting"));
    let second = domain.run(&["node", "list"]);
    second.failed(
        1,
        &[
            "quota of 1 sessions per user",
            "raise sessions_per_user of the Manager",
        ],
    );
}

#[test]
fn what_can_only_end_badly_is_refused_at_once() {
    let domain = Domain::new();
    for (options, told) in [
        (
            &["--sessions-per-user", "0"][..],
            "sessions_per_user is 0: give 1 to 4294967295",
        ),
        (
            &["--links-per-session", "65537"],
            "links_per_session is 65537: give 1 to 65536",
        ),
        (
            &["--greeting-ms", "0"],
            "greeting_ms is 0 s: give 1 ms to 86400 s",
        ),
        (
            &["--sessions-per-user", "4", "--sessions-per-process", "5"],
            "sessions_per_process is 5: give 1 to 4, the value of sessions_per_user, or raise that one",
        ),
    ] {
        let manager = domain.run(&[&["manager"], options].concat());
        manager.failed(2, &[told]);
        // No Manager claims the socket with such limits, and a standby says so when it starts.
        let standby = domain.run(&[&["manager", "--standby"], options].concat());
        standby.failed(2, &[told]);
    }
    let size = ["demo", "--size", "1000GB", "--seconds", "1"];
    let demo = Running::start(&mut sm2(&size)).finish();
    demo.failed(1, &["memory", "smaller --size"]);
}

#[test]
fn inputs_that_cannot_be_read_are_named() {
    let domain = Domain::new();
    let folder = domain.path("empty");
    fs::create_dir(&folder).unwrap();
    let folder = folder.to_str().unwrap();
    let publish = |from: &str| domain.run(&["topic", "pub", "a", "--from", from]);
    publish("/no/such/file").failed(
        1,
        &[
            "cannot read /no/such/file",
            "No such file",
            "check the path",
        ],
    );
    publish(folder).failed(1, &[folder, "holds no file"]);

    let unreadable = domain.path("unreadable");
    fs::write(&unreadable, "secret").unwrap();
    let mode = std::os::unix::fs::PermissionsExt::from_mode(0o000);
    fs::set_permissions(&unreadable, mode).unwrap();
    let from = unreadable.to_str().unwrap();
    if fs::read(&unreadable).is_ok() {
        skip("this user (root) may read every file");
    } else {
        publish(from).failed(
            1,
            &[from, "Permission denied", "give this user the permission"],
        );
    }

    // A file that can be opened and fails when it is read.
    let _echo = domain.start(&["topic", "echo", "a"]);
    publish("/proc/self/mem").failed(1, &["cannot read /proc/self/mem", "Input/output error"]);
    let looped = [
        "topic",
        "pub",
        "a",
        "--from",
        "/dev/null",
        "--lines",
        "--loop",
    ];
    domain
        .run(&looped)
        .failed(1, &["no message to publish", "empty"]);
}

#[test]
fn folders_that_cannot_be_written_are_named() {
    let domain = Domain::new();
    let echo = |to: &Path| {
        let to = to.to_str().unwrap();
        domain.run(&["topic", "echo", "a", "--to-dir", to])
    };
    let file = domain.path("file");
    fs::write(&file, "").unwrap();
    echo(&file).failed(1, &["cannot create folder", file.to_str().unwrap()]);

    let used = domain.path("used");
    fs::create_dir(&used).unwrap();
    fs::write(used.join("000003.bin"), "old").unwrap();
    echo(&used).failed(1, &["000003.bin", "name an empty folder"]);
}

/// Commands write their output at their end; `record` has its summary then.
#[test]
fn output_that_cannot_be_written_is_told() {
    let domain = Domain::new();
    let full = || File::options().write(true).open("/dev/full").unwrap();
    let bag = domain.path("b").display().to_string();
    let record = ["record", "--all", "--seconds", "0.1", "-o", &bag];
    let list = ["topic", "list", "--json"];
    for command in [&record[..], &["node", "list"], &list, &["snapshot"]] {
        let run = domain.command(command).stdout(full()).output().unwrap();
        let errors = String::from_utf8(run.stderr).unwrap();
        assert_eq!(run.status.code(), Some(1), "{command:?}: {errors}");
        let reason = "sm2: cannot write to standard output: No space";
        assert!(errors.contains(reason), "{command:?}: {errors}");
    }
}

#[test]
fn a_manager_that_cannot_say_why_fails_all_the_same() {
    let domain = Domain::new();
    let full = File::options().write(true).open("/dev/full").unwrap();
    let mut second = domain.command(&["manager"]);
    let mut second = second.stderr(full).spawn().unwrap();
    until("the second Manager ends", || {
        second.try_wait().unwrap().is_some()
    });
    assert_eq!(second.wait().unwrap().code(), Some(1));
}

#[test]
fn output_that_nobody_reads_is_a_quiet_end() {
    let domain = Domain::new();
    let (_talker, node) = talker(&domain, "a");
    for command in [
        &["topic", "list"][..],
        &["topic", "info", "a"],
        &["topic", "hz", "a", "--interval", "10ms"],
        &["topic", "bw", "a", "--interval", "10ms"],
        &["topic", "loss", "a", "--interval", "10ms"],
        &["topic", "delay", "nothing"],
        &["service", "list"],
        &["node", "list", "--json"],
        &["node", "info", &node],
        &["snapshot"],
        &["snapshot", "--watch"],
        &["wait", "node:x gone", "--json"],
        &["why", "a"],
        &["top", "--once", "--interval", "10ms"],
        &["doctor"],
    ] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let mut command_line = domain.command(command);
        let mut ended = command_line
            .stdout(writer)
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        // This process' end of the pipe is part of the command line.
        drop(command_line);
        until(&format!("{command:?} ends"), || {
            ended.try_wait().unwrap().is_some()
        });
        let ended = ended.wait_with_output().unwrap();
        let errors = String::from_utf8(ended.stderr).unwrap();
        assert_eq!(ended.status.code(), Some(0), "{command:?}: {errors}");
        let waits = errors.starts_with("sm2: waiting for") && errors.lines().count() == 1;
        assert!(errors.is_empty() || waits, "{command:?}: {errors}");
    }
}

#[test]
fn talk_that_nobody_hears_changes_nothing() {
    let domain = Domain::new();
    for (command, code) in [
        (&["wait", "node:x", "--timeout", "0"][..], 1),
        (&["topic", "info", "x"], 1),
        (&["topic", "echo", "two words"], 2),
        (
            &["topic", "pub", "a", "--from", "/dev/null", "--wait", "0"],
            0,
        ),
    ] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let mut ended = domain.command(command).stderr(writer).spawn().unwrap();
        until("it ends", || ended.try_wait().unwrap().is_some());
        let status = ended.wait().unwrap();
        assert_eq!(status.code(), Some(code), "{command:?}");
    }
}

/// A small file system, unmounted when it is dropped.
struct SmallDisk<'a>(&'a Path);

impl<'a> SmallDisk<'a> {
    fn mount(path: &'a Path) -> Option<Self> {
        fs::create_dir(path).unwrap();
        let mut mount = Command::new("mount");
        mount
            .args(["-t", "tmpfs", "-o", "size=64k", "tmpfs"])
            .arg(path);
        let mounted = mount.output().is_ok_and(|output| output.status.success());
        mounted.then(|| Self(path))
    }
}

impl Drop for SmallDisk<'_> {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(self.0).status();
    }
}

#[test]
fn a_full_disk_is_told_and_keeps_what_is_whole() {
    let domain = Domain::new();
    let path = domain.path("disk");
    let Some(disk) = SmallDisk::mount(&path) else {
        skip("this user cannot mount a small file system");
        return;
    };
    let input = domain.path("input");
    fs::write(&input, noise(3, 100_000)).unwrap();
    let to = disk.0.to_str().unwrap();
    let echo = domain.start(&["topic", "echo", "a", "--reliable", "--to-dir", to]);
    let from = input.to_str().unwrap();
    let publish = [
        "topic",
        "pub",
        "a",
        "--reliable",
        "--from",
        from,
        "--chunk",
        "25KB",
    ];
    let published = domain.run(&publish);
    assert_eq!(published.code(), 0, "{}", published.stderr());
    let echo = echo.finish();
    echo.failed_after(
        1,
        "received 2 messages (50 kB), lost 0\n",
        &[
            "cannot write",
            "000002.bin",
            "No space left on device",
            "free some space",
        ],
    );
    let files = files(disk.0);
    let sizes: Vec<_> = files
        .iter()
        .map(|(name, content)| (name.as_str(), content.len()))
        .collect();
    assert_eq!(sizes, [("000000.bin", 25_000), ("000001.bin", 25_000)]);
}

#[test]
fn a_file_too_large_to_be_written_is_told() {
    let domain = Domain::new();
    let to = domain.path("to");
    let input = domain.path("input");
    fs::write(&input, noise(4, 2_000_000)).unwrap();
    // The shell limits file sizes, and ignores the signal so that the write fails.
    let mut limited = Command::new("sh");
    limited
        .args(["-c", "trap '' XFSZ; ulimit -f 100; exec \"$0\" \"$@\""])
        .arg(env!("CARGO_BIN_EXE_sm2"))
        .args([
            "topic",
            "echo",
            "a",
            "--to-dir",
            to.to_str().unwrap(),
            "--socket",
        ])
        .arg(domain.path("sm2.sock"));
    let echo = Running::start(&mut limited);
    domain.run(&["topic", "pub", "a", "--from", input.to_str().unwrap()]);
    echo.finish().failed_after(
        1,
        "received 0 messages (0 bytes), lost 0\n",
        &["cannot write", "000000.bin", "File too large"],
    );
    assert!(files(&to).is_empty());
}

#[test]
fn waiting_in_vain_says_what_for() {
    let domain = Domain::new();
    let publish = domain.start(&["topic", "pub", "a", "--from", "/dev/null"]);
    domain.wait_for("a", "publishers", 1);
    let echo = domain.start(&["topic", "echo", "a", "--reliable"]);
    domain.wait_for("a", "subscribers", 1);
    // Each reports the other one.
    let told = |running: &Running, parts: [&str; 2]| {
        let stderr = running.stderr();
        until(&format!("{parts:?} is said"), || {
            parts.iter().all(|part| running.stderr().contains(part))
        });
        assert!(stderr.lines().count() <= 1, "{stderr}");
    };
    let echo_hint = "demands reliability";
    told(&echo, ["waiting for 1 publisher of a", echo_hint]);
    told(&publish, ["waiting for 1 subscriber of a", echo_hint]);
}

#[test]
fn a_subscriber_that_does_not_answer_is_named() {
    let domain = Domain::new();
    let echo = domain.start(&["topic", "echo", "a"]);
    domain.wait_for("a", "subscribers", 1);
    echo.signal(Signal::SIGSTOP);
    let node = format!(
        "node sm2-echo-{} is linked, but does not answer",
        echo.pid()
    );
    let start = || domain.start(&["topic", "pub", "a", "--from", "/dev/null"]);
    let mut publish = start();
    until("the node is named", || {
        publish.await_stderr("waiting for 1 subscriber of a");
        let is_named = publish.stderr().contains(&node);
        if !is_named {
            // On a busy machine, the link was not there when it said so.
            publish = start();
        }
        is_named
    });
    echo.signal(Signal::SIGCONT);
    assert_eq!(publish.finish().code(), 0);
}
