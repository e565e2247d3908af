//! The director's handle of a process of the demo.

use std::{
    fmt,
    io::{self, Read, Write},
    os::fd::{AsFd, BorrowedFd},
    process::{self, ChildStdin, ChildStdout, Command, ExitStatus, Stdio},
    thread,
    time::{Duration, Instant},
};

use super::part::{Figures, ProcessEvent, START};

/// Timeout for the end of a process after its standard input was closed.
const TIMEOUT: Duration = Duration::from_secs(5);

/// The role of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part {
    Publisher,
    /// A subscriber, numbered from 1.
    Subscriber(u32),
}

/// The progress of a process.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Stage {
    Starting,
    Ready,
    Done(Figures),
    /// The process failed, for this reason.
    Failed(String),
}

/// The result of a process.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Outcome<'a> {
    pub(crate) part: Part,
    pub(crate) stage: &'a Stage,
    /// The last counts that it reported.
    pub(crate) figures: Figures,
}

/// A running process, which is killed when this is dropped.
#[derive(Debug)]
pub(crate) struct Child {
    part: Part,
    process: process::Child,
    /// Standard input; closing it tells the process to end.
    stdin: Option<ChildStdin>,
    /// Standard output; the process closes it when it ends.
    stdout: Option<ChildStdout>,
    /// The incomplete last line of output.
    unread: Vec<u8>,
    stage: Stage,
    figures: Figures,
}

impl Child {
    /// Starts `command` in a process group of its own, so that Ctrl-C reaches only the director, which
    /// then ends its processes.
    ///
    /// # Errors
    ///
    /// The process cannot be started.
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

    /// The last counts that the process reported.
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

    /// The descriptor of its output; `None` when it has ended.
    pub(crate) fn output_fd(&self) -> Option<BorrowedFd<'_>> {
        self.stdout.as_ref().map(AsFd::as_fd)
    }

    /// Tells the process to start.
    pub(crate) fn begin(&mut self) {
        if let Some(stdin) = &mut self.stdin {
            // If the process is gone, reading its output reports that.
            let _ = stdin.write_all(START);
        }
    }

    /// Tells the process to end.
    pub(crate) fn end(&mut self) {
        self.stdin = None;
    }

    /// Reads its output, when the descriptor is readable.
    pub(crate) fn read_output(&mut self) {
        let mut buffer = [0; 4_096];
        let read = match &mut self.stdout {
            Some(stdout) => stdout.read(&mut buffer),
            None => return,
        };
        match read {
            Ok(0) => self.close_output(),
            Ok(len) => self.read_events(&buffer[..len]),
            // No signal interrupts it, because it does not wait.
            Err(_) => self.close_output(),
        }
    }

    fn read_events(&mut self, bytes: &[u8]) {
        self.unread.extend_from_slice(bytes);
        while let Some(end) = self.unread.iter().position(|&byte| byte == b'\n') {
            let line: Vec<u8> = self.unread.drain(..=end).collect();
            match serde_json::from_slice(&line) {
                Ok(ProcessEvent::Ready) => self.stage = Stage::Ready,
                Ok(ProcessEvent::Progress(figures)) => self.figures = figures,
                Ok(ProcessEvent::Done(figures)) => {
                    self.figures = figures;
                    self.stage = Stage::Done(figures);
                }
                Ok(ProcessEvent::Failed { reason }) => self.stage = Stage::Failed(reason),
                Err(error) => self.stage = Stage::Failed(format!("sent an invalid line: {error}")),
            }
        }
    }

    /// Handles the end of its output: the process is ending.
    fn close_output(&mut self) {
        self.stdout = None;
        if matches!(self.stage, Stage::Starting | Stage::Ready) {
            let status = self.wait();
            self.stage = Stage::Failed(match status {
                Some(status) => format!("ended too early ({status})"),
                None => "closed its output".into(),
            });
        }
    }

    /// Waits for its exit status. Kills the process after a timeout, and then returns `None`.
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
            // Both fail only if the process has ended and was waited for.
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

#[cfg(test)]
mod tests;
