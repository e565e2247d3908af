//! A process of the demo, as the demo sees it.

use std::{
    fmt,
    io::{self, Read, Write},
    os::fd::{AsFd, BorrowedFd},
    process::{self, ChildStdin, ChildStdout, Command, ExitStatus, Stdio},
    thread,
    time::{Duration, Instant},
};

use super::part::{Figures, START, Said};

/// The time that a process has to end after it was told to.
const TIMEOUT: Duration = Duration::from_secs(5);

/// Which part a process plays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    Publisher,
    /// From 1 on.
    Subscriber(u32),
}

/// How far it is.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Stage {
    Starting,
    Ready,
    Done(Figures),
    /// Why it ended too early.
    Failed(String),
}

/// What came of a process.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Outcome<'a> {
    pub(crate) part: Part,
    pub(crate) stage: &'a Stage,
    /// What it has said last of its counts.
    pub(crate) figures: Figures,
}

/// A running process. Dropped, it is killed.
#[derive(Debug)]
pub(crate) struct Child {
    part: Part,
    process: process::Child,
    /// Closed when it is to end.
    stdin: Option<ChildStdin>,
    /// Closed by the child when it is at its end.
    stdout: Option<ChildStdout>,
    /// The start of a line.
    unread: Vec<u8>,
    stage: Stage,
    figures: Figures,
}

impl Child {
    /// Starts `command`, in a process group of its own: Ctrl-C is for the demo, which tells
    /// its parts to end.
    ///
    /// # Errors
    ///
    /// What the operating system says.
    pub(crate) fn start(part: Part, command: &mut Command) -> io::Result<Self> {
        use std::os::unix::process::CommandExt;
        let mut process = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .process_group(0)
            .spawn()?;
        Ok(Self {
            part,
            stdin: process.stdin.take(),
            stdout: process.stdout.take(),
            process,
            unread: Vec::new(),
            stage: Stage::Starting,
            figures: Figures::default(),
        })
    }

    pub(crate) fn part(&self) -> Part {
        self.part
    }

    pub(crate) fn pid(&self) -> u32 {
        self.process.id()
    }

    pub(crate) fn stage(&self) -> &Stage {
        &self.stage
    }

    /// What it has said last of its counts.
    pub(crate) fn figures(&self) -> Figures {
        self.figures
    }

    pub(crate) fn outcome(&self) -> Outcome<'_> {
        Outcome {
            part: self.part,
            stage: &self.stage,
            figures: self.figures,
        }
    }

    /// Where it speaks; none once it has ended.
    pub(crate) fn voice(&self) -> Option<BorrowedFd<'_>> {
        self.stdout.as_ref().map(AsFd::as_fd)
    }

    /// Tells it to start.
    pub(crate) fn begin(&mut self) {
        if let Some(stdin) = &mut self.stdin {
            // If it is gone, its end of file says so.
            let _ = stdin.write_all(START);
        }
    }

    /// Tells it to end.
    pub(crate) fn end(&mut self) {
        self.stdin = None;
    }

    /// Takes in what it says, when its voice is readable.
    pub(crate) fn listen(&mut self) {
        let mut buffer = [0; 4_096];
        let read = match &mut self.stdout {
            Some(stdout) => stdout.read(&mut buffer),
            None => return,
        };
        match read {
            Ok(0) => self.silent(),
            Ok(len) => self.hear(&buffer[..len]),
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(_) => self.silent(),
        }
    }

    fn hear(&mut self, bytes: &[u8]) {
        self.unread.extend_from_slice(bytes);
        while let Some(end) = self.unread.iter().position(|&byte| byte == b'\n') {
            let line: Vec<u8> = self.unread.drain(..=end).collect();
            match serde_json::from_slice(&line) {
                Ok(Said::Ready) => self.stage = Stage::Ready,
                Ok(Said::Progress(figures)) => self.figures = figures,
                Ok(Said::Done(figures)) => {
                    self.figures = figures;
                    self.stage = Stage::Done(figures);
                }
                Ok(Said::Failed { reason }) => self.stage = Stage::Failed(reason),
                Err(error) => self.stage = Stage::Failed(format!("said what is no word: {error}")),
            }
        }
    }

    /// It has closed its standard output: it is ending.
    fn silent(&mut self) {
        self.stdout = None;
        if matches!(self.stage, Stage::Starting | Stage::Ready) {
            let status = self.wait();
            self.stage = Stage::Failed(match status {
                Some(status) => format!("ended too early ({status})"),
                None => "fell silent".into(),
            });
        }
    }

    /// Its exit status; none if it does not end, and was killed for that.
    fn wait(&mut self) -> Option<ExitStatus> {
        self.end();
        let until = Instant::now() + TIMEOUT;
        while Instant::now() < until {
            match self.process.try_wait() {
                Ok(None) => thread::sleep(Duration::from_millis(2)),
                Ok(status) => return status,
                Err(_) => break,
            }
        }
        None
    }
}

impl Drop for Child {
    fn drop(&mut self) {
        if !matches!(self.stage, Stage::Done(_)) || self.wait().is_none() {
            // Both fail only if it has ended and is waited for already.
            let _ = self.process.kill();
            let _ = self.process.wait();
        }
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Publisher => f.write_str("publisher"),
            Self::Subscriber(number) => write!(f, "subscriber {number}"),
        }
    }
}
