//! Runs every example of every `--help` text in a shell, each in its own domain.

mod world;

use std::{
    collections::BTreeSet,
    fs,
    os::unix::process::CommandExt,
    panic::{AssertUnwindSafe, catch_unwind},
    process::{Command, Stdio},
    sync::Mutex,
    thread,
    time::Duration,
};

use nix::{
    pty::openpty,
    sys::signal::{Signal, killpg},
    unistd::Pid,
};
use sm2_test_support::seed;

use self::world::{Shims, World, is_word_of};
use crate::{
    common::{Finished, Running, until},
    help::{commands, help},
};

/// Paths and values of a real machine in examples, and their replacements in this test.
const REPLACED: [(&str, &str); 8] = [
    ("/run/robot/", ""),
    ("/usr/local/share/", "share/"),
    ("/var/log/syslog", "robot.log"),
    ("127.0.0.1:9633", "127.0.0.1:0"),
    ("127.0.0.1:8000", "127.0.0.1:0"),
    // A person's desk has a browser.
    ("sm2 view --open", "sm2 view"),
    ("3f…e1", "$(cat base.id)"),
    ("sm2 demo --bad-link", "sm2 demo --seconds 6 --bad-link"),
];

/// How an example ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Ending {
    /// By itself.
    Exit,
    /// By Ctrl-C, as soon as it does something.
    Signal,
    /// By the key `q` on a terminal.
    Key,
}

#[test]
fn every_example_of_the_help_works() {
    // Written before other threads start processes.
    let shims = Shims::new();
    let workers = thread::available_parallelism().map_or(1, usize::from);
    let examples = Mutex::new(chosen().into_iter());
    let failed = Mutex::new(Vec::new());
    let next = || examples.lock().unwrap().next();
    let work = || {
        while let Some(example) = next() {
            if catch_unwind(AssertUnwindSafe(|| try_example(&example, &shims))).is_err() {
                failed.lock().unwrap().push(example);
            }
        }
    };
    thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(work);
        }
    });
    let failed = failed.into_inner().unwrap();
    assert!(failed.is_empty(), "these examples fail: {failed:#?}");
}

/// All examples if slow tests run, and else one of each ending, which the seed chooses. Demos are slow.
fn chosen() -> Vec<String> {
    let all: Vec<_> = examples().into_iter().collect();
    if cfg!(feature = "slow") {
        return all;
    }
    let one = |wanted: Ending| {
        let mut all = all.iter().filter(|it| !it.contains("sm2 demo"));
        let all: Vec<_> = all.by_ref().filter(|it| ending(it) == wanted).collect();
        all[seed() as usize % all.len()].clone()
    };
    [Ending::Exit, Ending::Signal, Ending::Key].map(one).into()
}

/// The examples of all commands, each once.
fn examples() -> BTreeSet<String> {
    fn collect(path: &mut Vec<String>, all: &mut BTreeSet<String>) {
        let words: Vec<_> = path.iter().map(String::as_str).collect();
        let help = help(&words);
        let (_, listed) = help.split_once("Examples:\n").unwrap_or_default();
        let lines = listed.lines().take_while(|line| line.starts_with("  "));
        // Two blanks begin a remark.
        let examples = lines.filter_map(|line| line.trim().split("  ").next());
        all.extend(examples.map(str::to_owned));
        let children: Vec<_> = commands(&help).into_iter().map(str::to_owned).collect();
        for child in children {
            path.push(child);
            collect(path, all);
            path.pop();
        }
    }
    let mut all = BTreeSet::new();
    collect(&mut Vec::new(), &mut all);
    assert!(all.len() > 80, "{} examples were found", all.len());
    all
}

fn ending(example: &str) -> Ending {
    let starts = |beginnings: &[&str]| beginnings.iter().any(|it| example.starts_with(it));
    let goes_on = [
        "sm2 manager",
        "sm2 gateway run",
        "sm2 snapshot --watch",
        "sm2 topic echo",
        "sm2 topic hz",
        "sm2 topic bw",
        "sm2 topic delay",
        "sm2 topic loss",
        "sm2 param watch",
        "sm2 view",
    ];
    if starts(&["sm2 top"]) && !starts(&["sm2 topic", "sm2 top --once", "sm2 top --json"]) {
        return Ending::Key;
    }
    let counts = example.contains("--count");
    match example.contains("--loop") || (starts(&goes_on) && !counts) {
        true => Ending::Signal,
        false => Ending::Exit,
    }
}

fn try_example(example: &str, shims: &Shims) {
    let mut script = example.to_owned();
    for (part, replacement) in REPLACED {
        script = script.replace(part, replacement);
    }
    if script.starts_with("sm2 demo") && !script.contains("--seconds") {
        script = script.replacen("sm2 demo", "sm2 demo --seconds 1", 1);
    }
    let world = World::new(example, shims);
    if is_word_of(example, "ask") {
        // The gateways need a moment to connect.
        return until(&format!("{example} succeeds"), || {
            Shell::start(&world, &script).finish().code() == 0
        });
    }
    let finished = match ending(example) {
        Ending::Exit => Shell::start(&world, &script).finish(),
        Ending::Signal => interrupted(&world, example, &script),
        Ending::Key => return quit_by_key(&world, &script),
    };
    // On a busy machine no message may pass the bad link in time; then the status is 1.
    let is_reported = example.contains("--bad-link") && finished.stdout().starts_with('{');
    assert!(
        finished.code() == 0 || is_reported,
        "{example}: {finished:?}"
    );
}

/// The end of an example that a signal ended after it had done something.
fn interrupted(world: &World, example: &str, script: &str) -> Finished {
    let shell = Shell::start(world, script);
    until(&format!("{example} does something"), || {
        if example.contains("sm2 topic pub") {
            return world.has_received();
        }
        match is_word_of(example, "manager") || is_word_of(example, "gateway") {
            true => !shell.running.stderr().is_empty(),
            false => !shell.running.stdout().is_empty(),
        }
    });
    shell.signal(Signal::SIGINT);
    shell.finish()
}

/// Runs an example on a terminal until the key `q` ends it.
fn quit_by_key(world: &World, script: &str) {
    let terminal = openpty(None, None).unwrap();
    let stdio = || Stdio::from(terminal.slave.try_clone().unwrap());
    let mut command = world.command("bash");
    command.args(["-c", script]).stdin(stdio()).stdout(stdio());
    let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
    drop((command, terminal.slave));
    let mut person = fs::File::from(terminal.master);
    let mut screen = person.try_clone().unwrap();
    // A terminal that nobody reads would block the command.
    let reader = thread::spawn(move || std::io::copy(&mut screen, &mut std::io::sink()));
    let mut status = None;
    until(&format!("{script} ends"), || {
        // Fails when the command has closed the terminal.
        let _ = std::io::Write::write_all(&mut person, b"q");
        thread::sleep(Duration::from_millis(50));
        status = child.try_wait().unwrap();
        status.is_some()
    });
    assert_eq!(status.unwrap().code(), Some(0), "{script}");
    // The last end of the terminal is closed, which the reader sees as an error.
    drop(reader.join().unwrap());
}

/// A shell with an example. Its whole process group is gone when it is dropped.
struct Shell {
    running: Running,
    group: Pid,
}

impl Shell {
    fn start(world: &World, script: &str) -> Self {
        let mut command: Command = world.command("bash");
        // The shell and filters such as jq survive Ctrl-C, so that the status is that of the command.
        let script = format!("set -o pipefail; trap '' INT; {script}");
        let running = Running::start(command.args(["-c", &script]).process_group(0));
        let group = Pid::from_raw(running.pid());
        Self { running, group }
    }

    fn signal(&self, signal: Signal) {
        killpg(self.group, signal).unwrap();
    }

    fn finish(mut self) -> Finished {
        let gone = Running::start(&mut Command::new("true"));
        std::mem::replace(&mut self.running, gone).finish()
    }
}

impl Drop for Shell {
    fn drop(&mut self) {
        // Fails if all of it has ended.
        let _ = killpg(self.group, Signal::SIGKILL);
    }
}
