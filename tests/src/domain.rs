//! Separate domains for tests: a temporary folder each, and Managers that serve there.

use std::{
    fs,
    os::unix::process::CommandExt,
    path::{Path, PathBuf},
    process::Command,
};

use nix::{
    sys::{
        resource::{Resource, getrlimit, setrlimit},
        signal::Signal,
    },
    unistd::{Uid, chown},
};
use rustix::process::{Pid, Rlimit, prlimit};
use tempfile::TempDir;

use crate::{
    census::{self, Census},
    process::{Exit, Process, actor},
    raw::RawNode,
};

/// How long a connection may take to greet, unless a test sets another limit. A busy machine exceeds the default.
const GREETING_TIMEOUT: [&str; 2] = ["--greeting-ms", "60000"];

/// A domain in a folder of its own, which is removed when this is dropped.
#[derive(Debug)]
pub struct TempDomain {
    folder: TempDir,
}

impl TempDomain {
    /// A domain without a Manager.
    #[must_use]
    pub fn new() -> Self {
        more_descriptors();
        // A short prefix: the path of a socket has at most 106 bytes.
        let folder = tempfile::Builder::new().prefix("sm2-").tempdir();
        Self {
            folder: folder.expect("a temporary folder"),
        }
    }

    /// The folder.
    #[must_use]
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// The path of the Manager's socket.
    #[must_use]
    pub fn socket(&self) -> PathBuf {
        self.folder().join("domain.sock")
    }

    /// The names of the files in the folder, sorted.
    #[must_use]
    pub fn files(&self) -> Vec<String> {
        let entries = fs::read_dir(self.folder()).expect("the folder");
        let mut names: Vec<String> = entries
            .map(|entry| entry.expect("an entry").file_name())
            .map(|name| name.to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    /// A Manager with its defaults, ready to serve.
    #[must_use]
    pub fn manager(&self) -> ManagerProcess {
        self.manager_with(&[])
    }

    /// A Manager with these options of the `manager` actor, ready to serve.
    #[must_use]
    pub fn manager_with(&self, options: &[&str]) -> ManagerProcess {
        let manager = self.manager_start(options);
        manager.process.stderr_says("serving");
        manager
    }

    /// A Manager that runs as this user. Only root can start one.
    #[must_use]
    pub fn manager_as(&self, user: Uid, options: &[&str]) -> ManagerProcess {
        chown(self.folder(), Some(user), None).expect("chown of the folder");
        let mut command = self.command(options);
        command.uid(user.as_raw()).gid(user.as_raw());
        let manager = self.start(command);
        manager.process.stderr_says("serving");
        manager
    }

    /// A Manager that may fail to start.
    #[must_use]
    pub fn manager_start(&self, options: &[&str]) -> ManagerProcess {
        self.start(self.command(options))
    }

    fn command(&self, options: &[&str]) -> Command {
        let mut command = actor("manager");
        command.arg("--socket").arg(self.socket());
        // The last value of an option counts.
        command.args(GREETING_TIMEOUT).args(options);
        command
    }

    fn start(&self, command: Command) -> ManagerProcess {
        ManagerProcess {
            process: Process::start(command),
            socket: self.socket(),
        }
    }
}

/// All tests of a file run in one process, and the usual soft limit is 1,024.
fn more_descriptors() {
    if let Ok((soft, hard)) = getrlimit(Resource::RLIMIT_NOFILE)
        && soft < hard
    {
        // If the system refuses, the current limit may suffice.
        let _ = setrlimit(Resource::RLIMIT_NOFILE, hard, hard);
    }
}

impl Default for TempDomain {
    fn default() -> Self {
        Self::new()
    }
}

/// A Manager in a separate process. Killed when dropped.
#[derive(Debug)]
pub struct ManagerProcess {
    process: Process,
    socket: PathBuf,
}

impl ManagerProcess {
    /// Its process id.
    #[must_use]
    pub fn pid(&self) -> u32 {
        self.process.pid()
    }

    /// The descriptors and mappings that the process has now.
    #[must_use]
    pub fn census(&self) -> Census {
        Census::of(self.pid())
    }

    /// As [`census`](Self::census), while none of its threads runs.
    #[must_use]
    #[track_caller]
    pub fn census_when_idle(&self) -> Census {
        Census::when_idle(self.pid())
    }

    /// Lowers its limit of files, so that it can open no further descriptor until it has closed one.
    #[track_caller]
    pub fn take_free_descriptors(&self) {
        let open = census::descriptor_numbers_when_idle(self.pid());
        let lowest_free = (0..).find(|fd| !open.contains(fd)).expect("a free number");
        let limit = Rlimit {
            current: Some(lowest_free),
            maximum: Some(lowest_free),
        };
        let pid = i32::try_from(self.pid()).ok().and_then(Pid::from_raw);
        prlimit(pid, rustix::process::Resource::Nofile, limit).expect("a limit of files");
    }

    /// A raw node that has not greeted.
    #[must_use]
    pub fn connect(&self) -> RawNode {
        RawNode::connect(&self.socket)
    }

    /// A raw node, welcomed under `name`.
    #[must_use]
    pub fn node(&self, name: &str) -> RawNode {
        RawNode::welcomed(&self.socket, name)
    }

    /// Waits until a line of its log contains this text.
    #[track_caller]
    pub fn log_says(&self, text: &str) {
        self.process.stderr_says(text);
    }

    /// Everything that it logged so far.
    #[must_use]
    pub fn log(&self) -> String {
        self.process.stderr()
    }

    /// Sends it a signal.
    pub fn signal(&mut self, signal: Signal) {
        self.process.signal(signal);
    }

    /// Stops the process; returns when it has stopped.
    #[track_caller]
    pub fn stop(&mut self) {
        self.process.stop();
    }

    /// Continues the stopped process.
    pub fn resume(&mut self) {
        self.process.resume();
    }

    /// Kills it (SIGKILL) and waits for its end.
    pub fn kill(&mut self) {
        self.process.kill();
    }

    /// Whether it has ended.
    pub fn has_ended(&mut self) -> bool {
        self.process.has_ended()
    }

    /// Waits for its end.
    pub fn wait(&mut self) -> Exit {
        self.process.wait()
    }
}
