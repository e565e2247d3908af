//! The guard: a process that ends the programs when `sm2 up` was killed.
//!
//! It reads the numbers of the process groups from a pipe whose other end only `sm2 up` has. The pipe ends with `sm2
//! up`, even by SIGKILL. The guard then sends SIGTERM to the groups, and SIGKILL after the stop timeout. A signal for
//! the death of a parent (`PR_SET_PDEATHSIG`) would reach the first process of each program only, and could not wait
//! between the two signals. A program whose `sm2 up` is killed within the moment between its start and the write to the
//! pipe is not known to the guard.

use std::{
    collections::BTreeSet,
    io::{self, BufRead, Write},
    os::unix::process::CommandExt,
    path::{Path, PathBuf},
    process::{ChildStdin, Command, Stdio},
    thread,
    time::Duration,
};

use clap::Parser;
use nix::{
    sys::signal::{Signal, killpg},
    unistd::Pid,
};
use sm2_io::clock;

use super::{
    limits::{GUARD_STEP, KILL_TIMEOUT},
    process::group_is_gone,
};
use crate::{ended::Ended, error::CliError, interrupt::Ignored};

/// The first argument of the process.
pub(crate) const GUARD: &str = "up-guard";

/// The command line of the process.
#[derive(Debug, Parser)]
pub(crate) struct GuardArguments {
    /// The time from SIGTERM to SIGKILL.
    stop_timeout_ms: u64,
    /// The process groups that exist already.
    groups: Vec<i32>,
}

/// The guard, and the process groups that it knows.
#[derive(Debug)]
pub(super) struct Guard {
    /// The path of this program, as it was at the start: an upgrade may replace the file.
    itself: PathBuf,
    stop_timeout: Duration,
    groups: BTreeSet<Pid>,
    pid: Pid,
    pipe: ChildStdin,
}

impl Guard {
    /// Starts the process.
    ///
    /// # Errors
    ///
    /// [`CliError::System`].
    pub(super) fn start(itself: PathBuf, stop_timeout: Duration) -> Result<Self, CliError> {
        let spawned = spawn(&itself, stop_timeout, &BTreeSet::new());
        let (pid, pipe) = spawned.map_err(CliError::system("start a process"))?;
        Ok(Self {
            itself,
            stop_timeout,
            groups: BTreeSet::new(),
            pid,
            pipe,
        })
    }

    /// Lets the guard end this group.
    pub(super) fn add(&mut self, group: Pid) {
        self.groups.insert(group);
        self.tell('+', group);
    }

    /// The group is gone, and its number may come again.
    pub(super) fn remove(&mut self, group: Pid) {
        self.groups.remove(&group);
        self.tell('-', group);
    }

    /// If this process was the guard, starts another one.
    ///
    /// # Errors
    ///
    /// The error of the operating system.
    pub(super) fn replace(&mut self, ended: Pid) -> io::Result<()> {
        if ended == self.pid {
            (self.pid, self.pipe) = spawn(&self.itself, self.stop_timeout, &self.groups)?;
        }
        Ok(())
    }

    fn tell(&mut self, sign: char, group: Pid) {
        // A guard that is gone is replaced when its end is known.
        let _ = writeln!(self.pipe, "{sign}{group}");
    }
}

fn spawn(
    itself: &Path,
    stop_timeout: Duration,
    groups: &BTreeSet<Pid>,
) -> io::Result<(Pid, ChildStdin)> {
    let mut child = Command::new(itself)
        .arg(GUARD)
        .arg(stop_timeout.as_millis().to_string())
        .args(groups.iter().map(ToString::to_string))
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        // Its folder may be unmounted.
        .current_dir("/")
        .process_group(0)
        .spawn()?;
    let pipe = child.stdin.take().ok_or(io::ErrorKind::BrokenPipe)?;
    Ok((Pid::from_raw(child.id().cast_signed()), pipe))
}

/// Runs the process of a guard.
///
/// # Errors
///
/// [`CliError::System`].
pub(crate) fn run(arguments: &GuardArguments) -> Result<Ended, CliError> {
    // A service manager may send it to all processes of a service.
    let _ignored = Ignored::install().map_err(CliError::system("catch signals"))?;
    let given = arguments.groups.iter().copied();
    let mut groups: BTreeSet<_> = given.map(Pid::from_raw).collect();
    for line in io::stdin().lock().lines().map_while(Result::ok) {
        let Some((sign, group)) = line.split_at_checked(1) else {
            continue;
        };
        // 0 would be the guard's own group, and -1 all processes.
        let Some(group) = group.parse().ok().filter(|group| *group > 1) else {
            continue;
        };
        match sign {
            "+" => groups.insert(Pid::from_raw(group)),
            _ => groups.remove(&Pid::from_raw(group)),
        };
    }
    for (signal, timeout) in [
        (
            Signal::SIGTERM,
            Duration::from_millis(arguments.stop_timeout_ms),
        ),
        (Signal::SIGKILL, KILL_TIMEOUT),
    ] {
        for group in &groups {
            let _ = killpg(*group, signal);
            let _ = killpg(*group, Signal::SIGCONT);
        }
        let until = clock::now().after(timeout);
        while !groups.is_empty() && clock::now() < until {
            thread::sleep(GUARD_STEP);
            groups.retain(|group| !group_is_gone(*group));
        }
    }
    Ok(Ended::Done)
}
