//! Starts programs in process groups, and ends them.

use std::ffi::OsString;
use std::fs::{self, OpenOptions};
use std::io;
use std::os::unix::process::{CommandExt as _, ExitStatusExt as _};
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use nix::sys::signal::{Signal, killpg};
use nix::unistd::Pid;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

/// Exit status of a program that this machine cannot run.
const CANNOT: i32 = 77;
const TURN: Duration = Duration::from_millis(50);
/// Timeout for the end of a program after SIGTERM.
const TIMEOUT: Duration = Duration::from_secs(3);

/// A flag that a signal sets.
pub(crate) struct Interrupts(Arc<AtomicBool>);

impl Interrupts {
    /// Handles SIGINT, SIGTERM and SIGHUP from now on.
    pub(crate) fn watch() -> io::Result<Self> {
        let flag = Arc::new(AtomicBool::new(false));
        for signal in [SIGINT, SIGTERM, SIGHUP] {
            signal_hook::flag::register(signal, Arc::clone(&flag))?;
        }
        Ok(Self(flag))
    }

    /// True if a signal has arrived.
    pub(crate) fn seen(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// The end of a program.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Ended {
    Well,
    /// This machine cannot run it.
    Skipped,
    /// It failed, with this status in words.
    Failed(String),
    /// It was ended by a signal, with all processes that it had started.
    Interrupted,
}

impl Ended {
    fn of(status: ExitStatus) -> Self {
        match (status.code(), status.signal()) {
            (Some(0), _) => Self::Well,
            (Some(CANNOT), _) => Self::Skipped,
            (Some(code), _) => Self::Failed(format!("status {code}")),
            (None, signal) => Self::Failed(format!("signal {}", signal.unwrap_or_default())),
        }
    }
}

/// Runs a program in a process group of its own, its output appended to `log`.
pub(crate) fn run(
    words: &[OsString],
    environment: &[(&str, OsString)],
    folder: &Path,
    log: &Path,
    stop: &Interrupts,
    mut turn: impl FnMut(),
) -> io::Result<Ended> {
    let Some((program, args)) = words.split_first() else {
        return Err(io::ErrorKind::InvalidInput.into());
    };
    let out = OpenOptions::new().create(true).append(true).open(log)?;
    let started = Command::new(program)
        .args(args)
        .envs(environment.iter().map(|(name, value)| (name, value)))
        .current_dir(folder)
        .stdin(Stdio::null())
        .stdout(out.try_clone()?)
        .stderr(out)
        .process_group(0)
        .spawn();
    let mut child = match started {
        Ok(child) => child,
        Err(error) => return Ok(Ended::Failed(format!("no start, {error},"))),
    };
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(Ended::of(status));
        }
        if stop.seen() {
            return end(&mut child).map(|()| Ended::Interrupted);
        }
        turn();
        thread::sleep(TURN);
    }
}

/// Ends the process group of `child`, by SIGTERM and then by SIGKILL.
fn end(child: &mut Child) -> io::Result<()> {
    let Ok(id) = i32::try_from(child.id()) else {
        return child.kill();
    };
    let group = Pid::from_raw(id);
    let _ = killpg(group, Signal::SIGTERM);
    let start = Instant::now();
    while child.try_wait()?.is_none() && start.elapsed() < TIMEOUT {
        thread::sleep(TURN);
    }
    // Processes of the program may outlive it. An error means that none is left.
    let _ = killpg(group, Signal::SIGKILL);
    child.wait().map(drop)
}

/// The number of lines of a file.
pub(crate) fn lines(path: &Path) -> usize {
    let count = |text: String| text.lines().count();
    fs::read_to_string(path).map_or(0, count)
}

#[cfg(test)]
mod tests {
    use sm2_test_support::SOON;

    use super::*;

    /// A machine that stops for seconds can use up the time of the program, so there are several attempts.
    #[test]
    fn an_interrupted_program_has_time_to_clean_up() {
        let script = "trap 'sleep 0.2; touch cleaned; exit' TERM
            touch started
            while :; do sleep 0.01; done";
        let words = ["sh", "-c", script].map(OsString::from);
        let cleans_up = || {
            let folder = tempfile::tempdir().unwrap();
            let [started, cleaned, log] =
                ["started", "cleaned", "log"].map(|it| folder.path().join(it));
            let stop = Interrupts(Arc::default());
            let mut turns = SOON.as_millis() / TURN.as_millis();
            let interrupt = || {
                turns = turns.checked_sub(1).expect("the program starts");
                stop.0.store(started.exists(), Ordering::Relaxed);
            };
            let ended = run(&words, &[], folder.path(), &log, &stop, interrupt);
            assert_eq!(ended.unwrap(), Ended::Interrupted);
            cleaned.exists()
        };
        assert!((0..5).any(|_| cleans_up()));
    }
}
