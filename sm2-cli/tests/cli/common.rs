//! Real `sm2` processes in the test's own domain.

use std::{
    ffi::OsStr,
    fmt, fs,
    io::Read,
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    sync::{Arc, Mutex},
    thread::{self, JoinHandle},
};

use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use serde_json::Value;
pub(crate) use sm2_test_support::{SOON, until};
use sm2_test_support::{memory, wait_until_stopped};
use tempfile::TempDir;

/// The `sm2` command, in an environment without a domain, and in a folder where nobody can make files: the tests
/// leave none in the repository.
pub(crate) fn sm2(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_sm2"));
    command.args(arguments).stdin(Stdio::null());
    command.current_dir("/proc");
    for variable in ["SM2_SOCKET", "SM2_DOMAIN", "SM2_LOG"] {
        command.env_remove(variable);
    }
    command
}

/// A Manager with its own folder. Dropping it ends the Manager and removes the folder.
pub(crate) struct Domain {
    folder: TempDir,
    manager: Running,
}

impl Domain {
    pub(crate) fn new() -> Self {
        Self::with(&[])
    }

    /// Starts `sm2 manager` with more arguments.
    pub(crate) fn with(arguments: &[&str]) -> Self {
        let folder = tempfile::tempdir_in(memory()).unwrap();
        let socket = folder.path().join("sm2.sock");
        let mut command = sm2(&["manager", "--socket"]);
        let mut manager = Running::start(command.arg(&socket).args(arguments));
        until("the Manager listens", || {
            let ended = manager.child.try_wait().unwrap();
            assert_eq!(ended, None, "the Manager ended: {}", manager.stderr());
            socket.exists()
        });
        Self { folder, manager }
    }

    /// A path in the domain's folder.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A command that talks to this domain.
    pub(crate) fn command(&self, arguments: &[&str]) -> Command {
        let mut command = sm2(arguments);
        command.current_dir(self.folder.path());
        command.arg("--socket").arg(self.path("sm2.sock"));
        command
    }

    /// Runs a command to its end.
    pub(crate) fn run(&self, arguments: &[&str]) -> Finished {
        Running::start(&mut self.command(arguments)).finish()
    }

    /// Starts a command.
    pub(crate) fn start(&self, arguments: &[&str]) -> Running {
        Running::start(&mut self.command(arguments))
    }

    /// The JSON output of a `list` command.
    pub(crate) fn list(&self, what: &str) -> Value {
        let list = self.run(&[what, "list", "--json"]);
        assert_eq!(list.code(), 0, "{list:?}");
        serde_json::from_str(&list.stdout()).unwrap()
    }

    /// Waits until a topic has `count` interfaces of `kind` (`publishers` or `subscribers`).
    pub(crate) fn wait_for(&self, topic: &str, kind: &str, count: u64) {
        until(&format!("{count} {kind} of {topic}"), || {
            let topics = self.list("topic");
            let mut topics = topics["topics"].as_array().unwrap().iter();
            topics.any(|it| it["name"] == topic && it[kind] == count)
        });
    }

    /// The JSON output of a command, which must succeed.
    pub(crate) fn json(&self, arguments: &[&str]) -> Value {
        self.json_ending_with(0, arguments)
    }

    /// The JSON output of a command, which must end with this status.
    pub(crate) fn json_ending_with(&self, status: i32, arguments: &[&str]) -> Value {
        let finished = self.run(&[arguments, &["--json"]].concat());
        assert_eq!(finished.code(), status, "{arguments:?}: {finished:?}");
        let stdout = finished.stdout();
        assert_eq!(stdout.lines().count(), 1, "{arguments:?}: {stdout}");
        serde_json::from_str(&stdout).unwrap()
    }

    /// Connects a node of this process.
    pub(crate) fn node(&self, name: &str) -> sm2_node::Node {
        let builder = sm2_node::Node::builder(name).socket(self.path("sm2.sock"));
        builder.manager_timeout(SOON).connect().unwrap()
    }

    pub(crate) fn stop_manager(&mut self) {
        self.manager.signal(Signal::SIGTERM);
        self.manager.wait();
    }

    pub(crate) fn manager_pid(&self) -> i32 {
        self.manager.pid()
    }

    pub(crate) fn signal_manager(&self, signal: Signal) {
        self.manager.signal(signal);
    }

    /// Kills the Manager with SIGKILL.
    pub(crate) fn kill_manager(&mut self) {
        self.manager.signal(Signal::SIGKILL);
        self.manager.wait();
    }

    /// Starts another Manager after the end of the last one.
    pub(crate) fn start_manager(&mut self) {
        let mut command = sm2(&["manager", "--socket"]);
        self.manager = Running::start(command.arg(self.path("sm2.sock")));
    }
}

/// A running process, whose output is read all the time. Dropping it kills the process.
pub(crate) struct Running {
    child: Child,
    stdout: Option<Reader>,
    stderr: Option<Reader>,
}

/// Collects what a process writes.
struct Reader {
    bytes: Arc<Mutex<Vec<u8>>>,
    thread: JoinHandle<()>,
}

/// A process that has ended.
pub(crate) struct Finished {
    pub(crate) status: ExitStatus,
    pub(crate) output: Vec<u8>,
    pub(crate) errors: Vec<u8>,
}

impl Running {
    pub(crate) fn start(command: &mut Command) -> Self {
        Self::start_into(command.stdout(Stdio::piped()))
    }

    /// Starts a process with a standard output of its own.
    pub(crate) fn start_into(command: &mut Command) -> Self {
        let mut child = command.stderr(Stdio::piped()).spawn().unwrap();
        let stdout = child.stdout.take().map(Reader::new);
        let stderr = child.stderr.take().map(Reader::new);
        Self {
            child,
            stdout,
            stderr,
        }
    }

    /// Starts a command whose output goes where it says.
    pub(crate) fn start_elsewhere(command: &mut Command) -> Self {
        Self {
            child: command.spawn().unwrap(),
            stdout: None,
            stderr: None,
        }
    }

    pub(crate) fn child(&mut self) -> &mut Child {
        &mut self.child
    }

    pub(crate) fn pid(&self) -> i32 {
        self.child.id().try_into().unwrap()
    }

    pub(crate) fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.pid()), signal).unwrap();
        if signal == Signal::SIGSTOP {
            wait_until_stopped(self.child.id());
        }
    }

    /// Waits until the process has written this text to standard output.
    pub(crate) fn await_stdout(&self, part: &str) {
        until(&format!("{part:?} is printed"), || {
            self.stdout().contains(part)
        });
    }

    /// Waits until the process has written this text to standard error.
    pub(crate) fn await_stderr(&self, part: &str) {
        until(&format!("{part:?} is said"), || {
            self.stderr().contains(part)
        });
    }

    fn wait(&mut self) -> ExitStatus {
        let mut status = None;
        until("a process ends", || {
            status = self.child.try_wait().unwrap();
            status.is_some()
        });
        status.unwrap()
    }

    /// Waits for the end of the process.
    pub(crate) fn finish(mut self) -> Finished {
        let status = self.wait();
        let read = |reader: Option<Reader>| reader.map(Reader::finish).unwrap_or_default();
        Finished {
            status,
            output: read(self.stdout.take()),
            errors: read(self.stderr.take()),
        }
    }

    /// The standard output of the process so far.
    pub(crate) fn stdout(&self) -> String {
        self.stdout.as_ref().unwrap().so_far()
    }

    /// The standard error of the process so far.
    pub(crate) fn stderr(&self) -> String {
        self.stderr.as_ref().unwrap().so_far()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl fmt::Debug for Finished {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Finished")
            .field("status", &self.status)
            .field("output", &String::from_utf8_lossy(&self.output))
            .field("errors", &String::from_utf8_lossy(&self.errors))
            .finish()
    }
}

impl Finished {
    /// The exit status.
    pub(crate) fn code(&self) -> i32 {
        self.status.code().unwrap_or(-1)
    }

    pub(crate) fn stdout(&self) -> String {
        String::from_utf8(self.output.clone()).unwrap()
    }

    pub(crate) fn stderr(&self) -> String {
        String::from_utf8(self.errors.clone()).unwrap()
    }

    /// Asserts that the process failed with this status, and with one line on standard error that contains all
    /// `parts`.
    pub(crate) fn failed(&self, code: i32, parts: &[&str]) {
        self.failed_after(code, "", parts);
    }

    /// As [`failed`](Self::failed), after `before` on standard error.
    pub(crate) fn failed_after(&self, code: i32, before: &str, parts: &[&str]) {
        let stderr = self.stderr();
        assert_eq!(self.code(), code, "{stderr}");
        let error = stderr.strip_prefix(before).unwrap_or_default();
        assert!(error.starts_with("sm2"), "{stderr}");
        assert_eq!(error.lines().count(), 1, "{stderr}");
        for part in parts {
            assert!(error.contains(part), "{part:?} is not in {error:?}");
        }
    }
}

impl Reader {
    fn new(mut from: impl Read + Send + 'static) -> Self {
        let bytes = Arc::new(Mutex::new(Vec::new()));
        let written = Arc::clone(&bytes);
        let thread = thread::spawn(move || {
            let mut buffer = [0; 65_536];
            while let Ok(len @ 1..) = from.read(&mut buffer) {
                written.lock().unwrap().extend_from_slice(&buffer[..len]);
            }
        });
        Self { bytes, thread }
    }

    fn so_far(&self) -> String {
        String::from_utf8_lossy(&self.bytes.lock().unwrap()).into_owned()
    }

    fn finish(self) -> Vec<u8> {
        self.thread.join().unwrap();
        std::mem::take(&mut self.bytes.lock().unwrap())
    }
}

/// Copies a program, by another process. If this process wrote the file, a child that another thread is just starting
/// would hold it open for writing, and the kernel does not execute such a file.
pub(crate) fn copy(from: impl AsRef<OsStr>, to: &Path) {
    let mut copy = Command::new("cp");
    let copy = copy.arg(from).arg(to);
    assert!(copy.status().unwrap().success());
}

/// The names and contents of a folder's files, in the order of their names.
pub(crate) fn files(folder: &Path) -> Vec<(String, Vec<u8>)> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap());
    let mut files: Vec<_> = entries
        .map(|entry| {
            let name = entry.file_name().into_string().unwrap();
            (name, fs::read(entry.path()).unwrap())
        })
        .collect();
    files.sort_unstable();
    files
}

/// A publisher of text at 200 Hz, until it is dropped, and the name of its node.
pub(crate) fn talker(domain: &Domain, topic: &str) -> (Running, String) {
    let publish = [
        "topic",
        "pub",
        topic,
        "--value",
        "\"hello\"",
        "--rate",
        "200",
        "--loop",
        "--wait",
        "0",
    ];
    let running = domain.start(&publish);
    domain.wait_for(topic, "publishers", 1);
    let name = format!("sm2-pub-{}", running.pid());
    (running, name)
}

/// A subscriber that prints messages, until it is dropped, and the name of its node.
pub(crate) fn listener(domain: &Domain, topic: &str, count: u64) -> (Running, String) {
    let running = domain.start(&["topic", "echo", topic]);
    domain.wait_for(topic, "subscribers", count);
    let name = format!("sm2-echo-{}", running.pid());
    (running, name)
}

/// The words of a line.
pub(crate) fn cells(line: &str) -> Vec<&str> {
    line.split_whitespace().collect()
}

/// Pseudo-random bytes.
pub(crate) fn noise(seed: u64, len: usize) -> Vec<u8> {
    let mut state = seed | 1;
    let step = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 32) as u8
    };
    std::iter::repeat_with(step).take(len).collect()
}
