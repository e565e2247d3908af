//! Taking the place of a Manager that runs: `--replace`.

use std::{
    fs, io,
    path::{Path, PathBuf},
    thread,
    time::{Duration, Instant},
};

use nix::{
    errno::Errno,
    sys::signal::{Signal, kill},
    unistd::Pid,
};
use sm2_io::{DomainSocketError, SeqPacket};
use tracing::info;

use crate::{Manager, Options, StartError};

/// How long the other Manager may take. It gives up its lock at once, or never.
const HAND_OVER_TIMEOUT: Duration = Duration::from_secs(5);
/// How often the lock is tried: often enough to be first, before standbys are told.
const PAUSE: Duration = Duration::from_millis(1);
/// How often it looks who serves: each look is a connection that waits to be accepted.
const LOOK: Duration = Duration::from_millis(200);

/// Why the place of a Manager was not taken.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReplaceError {
    /// It was free, or became free, and is not fit.
    #[error(transparent)]
    Start(#[from] StartError),
    /// Somebody has the lock and cannot be asked.
    #[error("cannot ask the Manager that serves {path:?} to hand over: {source}")]
    NotThere {
        /// The socket's path.
        path: PathBuf,
        /// What connecting to it said.
        source: io::Error,
    },
    /// It runs in a pid namespace that is not visible from here.
    #[error(
        "the Manager that serves {path:?} runs where its process cannot be seen from here, such as in another container: start this one with --standby, and send SIGUSR2 to that one"
    )]
    Hidden {
        /// The socket's path.
        path: PathBuf,
    },
    /// The signal would end it.
    #[error(
        "process {pid} serves {path:?} and does not listen to SIGUSR2, so it is a program that embeds its Manager: start this one with --standby, and end that program when it suits"
    )]
    Embedded {
        /// The socket's path.
        path: PathBuf,
        /// Whose it is.
        pid: i32,
    },
    /// It belongs to somebody else.
    #[error(
        "process {pid} serves {path:?} and belongs to another user: run this as that user or as root"
    )]
    NotPermitted {
        /// The socket's path.
        path: PathBuf,
        /// Whose it is.
        pid: i32,
    },
    /// It did not do it.
    #[error(
        "process {pid} was asked to hand over {path:?} and did not within 5 s: its log says why"
    )]
    Kept {
        /// The socket's path.
        path: PathBuf,
        /// Whose it is.
        pid: i32,
    },
}

/// Serves at `path`; if another Manager does, asks it to hand over and waits for its lock.
//= SM2-RES-010, SM2-TRN-008
pub(super) fn take_over(path: &Path, options: Options) -> Result<Manager, ReplaceError> {
    let start = Instant::now();
    let mut look_at = start;
    // If a standby was faster, that one is asked, too.
    let mut asked = None;
    loop {
        match Manager::bind(path, options) {
            Err(StartError::DomainSocket(DomainSocketError::Busy { .. })) => {}
            result => return Ok(result?),
        }
        if Instant::now() >= look_at {
            look_at += LOOK;
            let late = start.elapsed() > HAND_OVER_TIMEOUT;
            let path = path.to_owned();
            match (server_of(&path), asked) {
                (Ok(pid), _) if asked != Some(pid) => {
                    ask(path, pid)?;
                    asked = Some(pid);
                }
                (_, Some(pid)) if late => return Err(ReplaceError::Kept { path, pid }),
                (Err(source), None) if late => return Err(ReplaceError::NotThere { path, source }),
                // It has not begun to listen, or has just ended.
                _ => {}
            }
        }
        thread::sleep(PAUSE);
    }
}

/// The process that listens at `path`, by the kernel's word.
fn server_of(path: &Path) -> io::Result<i32> {
    Ok(SeqPacket::connect(path)?.peer_credentials()?.pid)
}

fn ask(path: PathBuf, pid: i32) -> Result<(), ReplaceError> {
    if pid == 0 {
        return Err(ReplaceError::Hidden { path });
    }
    match catches_sigusr2(pid) {
        // To a process that does not expect it, the signal is the end.
        Some(false) => return Err(ReplaceError::Embedded { path, pid }),
        Some(true) => {}
        None => return Ok(()),
    }
    match kill(Pid::from_raw(pid), Signal::SIGUSR2) {
        Ok(()) => info!(pid, "asked the Manager that serves to hand over"),
        Err(Errno::EPERM) => return Err(ReplaceError::NotPermitted { path, pid }),
        // It has ended meanwhile.
        Err(_) => {}
    }
    Ok(())
}

/// Whether it does; none if there is no such process any more.
fn catches_sigusr2(pid: i32) -> Option<bool> {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let caught = status.lines().find_map(|it| it.strip_prefix("SigCgt:"))?;
    let caught = u64::from_str_radix(caught.trim(), 16).ok()?;
    Some(caught & 1 << (Signal::SIGUSR2 as u32 - 1) != 0)
}
