//! `--replace`: takes the domain over from a Manager that serves it.

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

/// How long the other Manager may take. It releases its lock at once, or never.
const HAND_OVER_TIMEOUT: Duration = Duration::from_secs(5);
/// How often the lock is tried: short enough to get it before standbys are dismissed.
const PAUSE: Duration = Duration::from_millis(1);
/// How often the process that serves is looked up. Each look-up leaves a connection that waits to
/// be accepted.
const LOOK: Duration = Duration::from_millis(200);

/// The reason why a Manager was not replaced.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReplaceError {
    /// The domain is free, but this Manager could not start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// Another process holds the lock but does not accept connections.
    #[error("cannot ask the Manager that serves {path:?} to hand over: {source}")]
    NotThere {
        /// The socket's path.
        path: PathBuf,
        /// The error of connecting to it.
        r#source: io::Error,
    },
    /// The other Manager runs in a pid namespace that is not visible from here.
    #[error(
        "the Manager that serves {path:?} runs in another pid namespace, such as a container: start this one \
         with --standby, then send SIGUSR2 to the other one there"
    )]
    Hidden {
        /// The socket's path.
        path: PathBuf,
    },
    /// The process does not handle SIGUSR2, so the signal would kill it.
    #[error(
        "process {pid} serves {path:?} but does not handle SIGUSR2, so it probably embeds its Manager: start \
         this one with --standby, then stop process {pid}"
    )]
    Embedded {
        /// The socket's path.
        path: PathBuf,
        /// The process that serves.
        pid: i32,
    },
    /// The process belongs to another user.
    #[error(
        "process {pid} serves {path:?} and belongs to another user: run this command as that user or as root"
    )]
    NotPermitted {
        /// The socket's path.
        path: PathBuf,
        /// The process that serves.
        pid: i32,
    },
    /// The process did not hand over.
    #[error("process {pid} did not hand over {path:?} within 5 s: see its log for the reason")]
    Kept {
        /// The socket's path.
        path: PathBuf,
        /// The process that serves.
        pid: i32,
    },
}

/// Serves at `path`. If another Manager serves there, asks it to hand over and waits for its lock.
//= SM2-RES-009, SM2-TRN-007
pub(super) fn take_over(path: &Path, options: Options) -> Result<Manager, ReplaceError> {
    take_over_within(path, &options, HAND_OVER_TIMEOUT)
}

fn take_over_within(
    path: &Path,
    options: &Options,
    timeout: Duration,
) -> Result<Manager, ReplaceError> {
    let start = Instant::now();
    let mut look_at = start;
    // If a standby took the lock first, that standby is asked next.
    let mut asked = None;
    loop {
        match Manager::bind(path, options.clone()) {
            Err(StartError::DomainSocket(DomainSocketError::Busy { .. })) => {}
            result => return Ok(result?),
        }
        if Instant::now() >= look_at {
            look_at += LOOK;
            let late = start.elapsed() > timeout;
            let path = path.to_owned();
            match (server_of(&path), asked) {
                (Ok(pid), _) if asked != Some(pid) => {
                    ask(path, pid)?;
                    asked = Some(pid);
                }
                (_, Some(pid)) if late => return Err(ReplaceError::Kept { path, pid }),
                (Err(source), None) if late => return Err(ReplaceError::NotThere { path, source }),
                // The other process is not listening yet, or has just ended.
                _ => {}
            }
        }
        thread::sleep(PAUSE);
    }
}

/// Returns the process that listens at `path`, as reported by the kernel.
fn server_of(path: &Path) -> io::Result<i32> {
    Ok(SeqPacket::connect(path)?.peer_credentials()?.pid)
}

fn ask(path: PathBuf, pid: i32) -> Result<(), ReplaceError> {
    if pid == 0 {
        return Err(ReplaceError::Hidden { path });
    }
    match catches_sigusr2(pid) {
        // The signal would kill a process without a handler.
        Some(false) => return Err(ReplaceError::Embedded { path, pid }),
        Some(true) => {}
        None => return Ok(()),
    }
    match kill(Pid::from_raw(pid), Signal::SIGUSR2) {
        Ok(()) => info!(pid, "asked the Manager that serves to hand over"),
        Err(Errno::EPERM) => return Err(ReplaceError::NotPermitted { path, pid }),
        // The process has ended in the meantime.
        Err(_) => {}
    }
    Ok(())
}

/// Whether the process handles SIGUSR2; `None` if there is no such process any more.
fn catches_sigusr2(pid: i32) -> Option<bool> {
    let status = fs::read_to_string(format!("/proc/{pid}/status")).ok()?;
    let caught = status.lines().find_map(|it| it.strip_prefix("SigCgt:"))?;
    let caught = u64::from_str_radix(caught.trim(), 16).ok()?;
    Some(caught & 1 << (Signal::SIGUSR2 as u32 - 1) != 0)
}

#[cfg(test)]
mod tests {
    use signal_hook::{consts::SIGUSR2, iterator::Signals};
    use sm2_io::{DomainLock, Listener};
    use sm2_test_support::SOON;

    use super::*;

    const TIMEOUT: Duration = Duration::from_millis(300);

    /// The error of taking a domain from a process that keeps its lock.
    fn refused(path: &Path) -> ReplaceError {
        let taken = take_over_within(path, &Options::default(), TIMEOUT);
        taken.map(drop).expect_err("the lock is held")
    }

    #[test]
    fn a_process_that_holds_the_lock_and_does_not_serve_is_named_after_a_while() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("domain.sock");
        let _lock = DomainLock::acquire(&path).unwrap();
        let error = refused(&path);
        assert!(matches!(error, ReplaceError::NotThere { .. }), "{error:?}");
    }

    /// It may be about to serve, or to end.
    //= SM2-RES-009 test
    #[test]
    fn a_process_that_holds_the_lock_is_given_time() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("domain.sock");
        let lock = DomainLock::acquire(&path).unwrap();
        thread::scope(|scope| {
            let take = || take_over_within(&path, &Options::default(), SOON).map(drop);
            let taking = scope.spawn(take);
            // It has tried by now, or finds the lock free.
            thread::sleep(Duration::from_millis(50));
            drop(lock);
            taking.join().unwrap().expect("a Manager");
        });
    }

    /// This process is asked: it serves the domain, and has a handler for the signal.
    //= SM2-RES-009 test
    #[test]
    fn a_process_that_keeps_its_domain_is_asked_once_and_named_after_a_while() {
        let mut signals = Signals::new([SIGUSR2]).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("domain.sock");
        let _lock = DomainLock::acquire(&path).unwrap();
        let listener = Listener::bind(&path, 1_000).unwrap();
        let error = refused(&path);
        let own = Pid::this().as_raw();
        assert!(
            matches!(error, ReplaceError::Kept { pid, .. } if pid == own),
            "{error:?}"
        );
        assert_eq!(signals.pending().collect::<Vec<_>>(), [SIGUSR2]);
        // Each look-up leaves a connection, so they are rare.
        let connections = std::iter::from_fn(|| listener.accept().unwrap()).count();
        assert!((2..10).contains(&connections), "{connections}");
    }

    #[test]
    fn the_signals_that_a_process_catches_are_told() {
        let _signals = Signals::new([SIGUSR2]).unwrap();
        assert_eq!(catches_sigusr2(Pid::this().as_raw()), Some(true));
        assert_eq!(catches_sigusr2(i32::MAX), None);
        let mut idle = std::process::Command::new("sleep")
            .arg("60")
            .spawn()
            .unwrap();
        let caught = catches_sigusr2(idle.id().cast_signed());
        idle.kill().unwrap();
        idle.wait().unwrap();
        assert_eq!(caught, Some(false));
    }
}
