//! Child processes: started from the actor binary, watched, and ended with the test.

use std::{
    io::{BufRead, BufReader, Read, Write},
    os::unix::process::ExitStatusExt,
    path::{Path, PathBuf},
    process::{Child, ChildStdin, Command, ExitStatus, Stdio},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        mpsc::{Receiver, RecvTimeoutError, channel},
    },
    thread::{self, JoinHandle},
};

use nix::{
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use sm2_test_support::wait_until_stopped;

use crate::{TIMEOUT, census::Census, eventually};

/// A command that runs the actor in `role`.
///
/// # Panics
///
/// If the actor has not been built, which Cargo does for the tests of this package.
#[must_use]
pub fn actor(role: &str) -> Command {
    command(actor_path(), role)
}

/// A command that runs this program in `role`.
///
/// # Panics
///
/// If the system does not know the path of this program.
#[must_use]
pub fn this_program(role: &str) -> Command {
    let program = std::env::current_exe().expect("the path of this program");
    command(program, role)
}

fn command(program: PathBuf, role: &str) -> Command {
    let mut command = Command::new(program);
    command.arg(role);
    // Tests must not use the domain of the caller.
    for variable in ["SM2_SOCKET", "SM2_DOMAIN", "SM2_LOG", "XDG_RUNTIME_DIR"] {
        command.env_remove(variable);
    }
    command
}

/// The path of the actor: from Cargo, or beside the folder of the running test.
fn actor_path() -> PathBuf {
    if let Some(path) = std::env::var_os("CARGO_BIN_EXE_sm2-test-actor") {
        return path.into();
    }
    let test = std::env::current_exe().expect("the test's own path");
    let folder = test.parent().and_then(Path::parent).expect("target folder");
    let path = folder.join("sm2-test-actor");
    assert!(path.exists(), "{path:?} is missing: run cargo test");
    path
}

/// How a process ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// It exited with this status.
    Status(i32),
    /// It was killed by this signal.
    Signal(i32),
}

impl From<ExitStatus> for Exit {
    fn from(status: ExitStatus) -> Self {
        match (status.code(), status.signal()) {
            (Some(code), _) => Self::Status(code),
            (None, signal) => Self::Signal(signal.unwrap_or(0)),
        }
    }
}

/// A child. Its output is collected; it is killed when this is dropped.
#[derive(Debug)]
pub struct Process {
    child: Child,
    stdin: Option<ChildStdin>,
    lines: Receiver<String>,
    stderr: Arc<Mutex<String>>,
    /// Collects the standard error. `None` once all of it was collected.
    collector: Option<JoinHandle<()>>,
}

/// A child that has ended, with everything that it wrote.
#[derive(Clone, Debug)]
pub struct Finished {
    /// How it ended.
    pub exit: Exit,
    /// The lines of its output that [`Process::line`] had not returned.
    pub lines: Vec<String>,
    /// Its standard error.
    pub stderr: String,
}

impl Process {
    /// Starts `command`.
    #[must_use]
    pub fn start(mut command: Command) -> Self {
        command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        let mut child = command.spawn().expect("a child process");
        let (sender, lines) = channel();
        let stdout = BufReader::new(child.stdout.take().expect("its output"));
        thread::spawn(move || {
            for line in stdout.lines().map_while(Result::ok) {
                if sender.send(line).is_err() {
                    return;
                }
            }
        });
        let stderr = Arc::new(Mutex::new(String::new()));
        let collected = Arc::clone(&stderr);
        let source = child.stderr.take().expect("its errors");
        let collector = thread::spawn(move || collect(source, &collected));
        Self {
            stdin: child.stdin.take(),
            child,
            lines,
            stderr,
            collector: Some(collector),
        }
    }

    /// Its process id.
    #[must_use]
    pub fn pid(&self) -> u32 {
        self.child.id()
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

    /// Writes a line to its standard input; ignores errors of a child that has ended.
    pub fn say(&mut self, line: &str) {
        if let Some(stdin) = &mut self.stdin {
            let _ = writeln!(stdin, "{line}").and_then(|()| stdin.flush());
        }
    }

    /// The next line of its output, or `None` after it has ended.
    #[must_use]
    #[track_caller]
    pub fn line(&self) -> Option<String> {
        match self.lines.recv_timeout(TIMEOUT) {
            Ok(line) => Some(line),
            Err(RecvTimeoutError::Disconnected) => None,
            Err(RecvTimeoutError::Timeout) => {
                panic!("process {} says nothing: {}", self.pid(), self.stderr())
            }
        }
    }

    /// The next line of its output, if it has arrived.
    #[must_use]
    pub fn try_line(&self) -> Option<String> {
        self.lines.try_recv().ok()
    }

    /// The next line of its output, which must arrive.
    #[track_caller]
    pub fn expect_line(&self) -> String {
        let Some(line) = self.line() else {
            panic!("process {} ended: {}", self.pid(), self.stderr());
        };
        line
    }

    /// The standard error of the process so far.
    #[must_use]
    pub fn stderr(&self) -> String {
        lock(&self.stderr).clone()
    }

    /// Waits until its standard error contains this text.
    #[track_caller]
    pub fn stderr_says(&self, text: &str) {
        eventually(text, || lock(&self.stderr).contains(text));
    }

    /// Sends it a signal, unless it has ended.
    pub fn signal(&mut self, signal: Signal) {
        // Its process number is not reused before we have waited for it.
        if !self.has_ended() {
            let _ = kill(Pid::from_raw(self.pid().cast_signed()), signal);
        }
    }

    /// Stops the process (SIGSTOP); returns when it has stopped.
    #[track_caller]
    pub fn stop(&mut self) {
        self.signal(Signal::SIGSTOP);
        wait_until_stopped(self.pid());
    }

    /// Continues the stopped process (SIGCONT).
    pub fn resume(&mut self) {
        self.signal(Signal::SIGCONT);
    }

    /// Kills it (SIGKILL) and waits for its end.
    pub fn kill(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Whether it has ended.
    pub fn has_ended(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(Some(_)))
    }

    /// Waits for its end.
    #[track_caller]
    pub fn wait(&mut self) -> Exit {
        let mut exit = None;
        eventually("the end of a process", || {
            exit = self.child.try_wait().expect("a child of ours");
            exit.is_some()
        });
        exit.map_or(Exit::Status(0), Exit::from)
    }

    /// Waits for its end, and for the rest of its output. Closes its standard input.
    #[must_use]
    #[track_caller]
    pub fn finish(&mut self) -> Finished {
        self.stdin = None;
        let exit = self.wait();
        let lines = std::iter::from_fn(|| self.line()).collect();
        if let Some(collector) = self.collector.take() {
            // A panic of the collector would have lost text only.
            let _ = collector.join();
        }
        let stderr = self.stderr();
        Finished {
            exit,
            lines,
            stderr,
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill();
        if thread::panicking() {
            eprintln!("process {} said: {}", self.pid(), self.stderr());
        }
    }
}

fn collect(mut source: impl Read, into: &Mutex<String>) {
    let mut buffer = [0; 4096];
    while let Ok(len @ 1..) = source.read(&mut buffer) {
        lock(into).push_str(&String::from_utf8_lossy(&buffer[..len]));
    }
}

fn lock(text: &Mutex<String>) -> MutexGuard<'_, String> {
    text.lock().unwrap_or_else(PoisonError::into_inner)
}
