//! A running program: its process group, and what it prints.
//!
//! A program is the leader of a process group of its own, so Ctrl-C at the terminal reaches `sm2 up` alone, which then
//! ends the programs in order. All signals go to the group, which includes what the program has started, unless that
//! has left the group (`setsid`). The crate `process-wrap` would add nothing to `process_group` of std and `killpg`.

use std::{
    fmt,
    io::{self, PipeReader, Read, pipe},
    os::{
        fd::{AsFd, BorrowedFd},
        unix::process::CommandExt,
    },
    path::Path,
    process::{Command, Stdio},
};

use nix::{
    errno::Errno,
    fcntl::{FcntlArg, OFlag, fcntl},
    sys::{
        signal::{Signal, killpg},
        wait::{WaitPidFlag, WaitStatus, waitpid},
    },
    unistd::Pid,
};
use sm2_io::clock;
use sm2_proto::Instant;

use super::{
    limits::{LINE_MAX_BYTES, PIPE_BYTES, READ_MAX_BYTES},
    lines::Lines,
    robot::Program,
};

/// A program that was started. Its process group may outlive its first process.
#[derive(Debug)]
pub(super) struct Process {
    pid: Pid,
    pub(super) since: Instant,
    /// Standard output and standard error, which share one pipe, so that their lines keep their order.
    output: PipeReader,
    /// Whether a process can still write to it.
    pub(super) is_open: bool,
    lines: Lines,
    /// The end of the first process.
    pub(super) exit: Option<Exit>,
}

/// The end of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Exit {
    Status(i32),
    Signal(Signal),
}

impl Process {
    /// Starts a program. The variable `SM2_SOCKET` has the path of its domain's socket.
    ///
    /// # Errors
    ///
    /// The error of the operating system.
    pub(super) fn start(program: &Program, socket: &Path) -> io::Result<Self> {
        let (output, writer) = pipe()?;
        fcntl(&output, FcntlArg::F_SETFL(OFlag::O_NONBLOCK))?;
        let mut command = Command::new(&program.command[0]);
        command
            .args(&program.command[1..])
            .current_dir(&program.folder)
            .env("SM2_SOCKET", socket)
            .envs(
                program
                    .environment
                    .iter()
                    .map(|(name, value)| (name, value)),
            )
            .stdin(Stdio::null())
            .stdout(writer.try_clone()?)
            .stderr(writer)
            .process_group(0);
        let child = command.spawn()?;
        Ok(Self {
            // The kernel's numbers of processes are positive and below 2^22.
            pid: Pid::from_raw(child.id().cast_signed()),
            since: clock::now(),
            output,
            is_open: true,
            lines: Lines::default(),
            exit: None,
        })
    }

    /// The number of the process, which is also that of its group.
    pub(super) const fn pid(&self) -> Pid {
        self.pid
    }

    /// Sends a signal to all processes of the group. A group that is gone needs none.
    pub(super) fn signal(&self, signal: Signal) {
        let _ = killpg(self.pid, signal);
    }

    /// Whether no process of the group is left. One that has ended counts until it is [reaped](reap).
    pub(super) fn is_gone(&self) -> bool {
        group_is_gone(self.pid)
    }

    /// The lines that were printed since the last call, at most [`READ_MAX_BYTES`].
    pub(super) fn read(&mut self) -> Vec<String> {
        let mut lines = Vec::new();
        let mut buffer = [0; LINE_MAX_BYTES];
        for _ in 0..READ_MAX_BYTES / LINE_MAX_BYTES {
            match self.output.read(&mut buffer) {
                Ok(len @ 1..) => lines.extend(self.lines.push(&buffer[..len])),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Ok(0) => {
                    self.is_open = false;
                    break;
                }
                // Nothing is there now.
                Err(_) => break,
            }
        }
        lines
    }

    /// The last lines of a program whose group is gone. A process that has left the group may write on for ever.
    pub(super) fn last_lines(&mut self) -> Vec<String> {
        let mut all = Vec::new();
        for _ in 0..PIPE_BYTES / READ_MAX_BYTES {
            let lines = self.read();
            match lines.is_empty() {
                true => break,
                false => all.extend(lines),
            }
        }
        all.extend(self.lines.finish());
        all
    }
}

impl AsFd for Process {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.output.as_fd()
    }
}

/// `exited with status 1`, `was ended by SIGKILL`
impl fmt::Display for Exit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Status(status) => write!(f, "exited with status {status}"),
            Self::Signal(signal) => write!(f, "was ended by {signal}"),
        }
    }
}

/// Whether a process group has no process.
pub(super) fn group_is_gone(group: Pid) -> bool {
    killpg(group, None) == Err(Errno::ESRCH)
}

/// Takes the ends of all children, which include the orphans of programs.
pub(super) fn reap() -> Vec<(Pid, Exit)> {
    let mut ended = Vec::new();
    loop {
        match waitpid(None, Some(WaitPidFlag::WNOHANG)) {
            Ok(WaitStatus::Exited(pid, status)) => ended.push((pid, Exit::Status(status))),
            Ok(WaitStatus::Signaled(pid, signal, _)) => ended.push((pid, Exit::Signal(signal))),
            Ok(WaitStatus::StillAlive) => break,
            Err(Errno::ECHILD) => break,
            // A realtime signal has no name here. Its process is gone, as the group will show.
            Ok(_) | Err(_) => {}
        }
    }
    ended
}
