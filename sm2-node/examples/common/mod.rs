//! What the examples share: their arguments, and how they end.
#![allow(dead_code, reason = "each example uses its own part")]

use std::any::type_name;
use std::error::Error;
use std::io;
use std::process::{ExitCode, Termination};
use std::str::FromStr;
use std::time::Duration;

use nix::sys::signal::{SigSet, Signal};
use nix::sys::signalfd::{SfdFlags, SignalFd};
use nix::sys::time::TimeSpec;
use nix::sys::timerfd::{ClockId, Expiration, TimerFd, TimerFlags, TimerSetTimeFlags};

/// What comes of an example, or of a part of it.
pub(crate) type Outcome<T = ()> = Result<T, Box<dyn Error + Send + Sync>>;

/// What a shell expects of a program that Ctrl-C ended: 128 and the signal's number.
pub(crate) const INTERRUPTED: u8 = 130;

/// Runs an example. What goes wrong is one line on standard error; that nobody reads its
/// output any more (`… | head`) is not wrong.
pub(crate) fn run<T: Termination>(example: impl FnOnce() -> Outcome<T>) -> ExitCode {
    match example() {
        Ok(value) => value.report(),
        Err(error) if is_broken_pipe(&*error) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{}: {error}", env!("CARGO_BIN_NAME"));
            ExitCode::FAILURE
        }
    }
}

fn is_broken_pipe(error: &(dyn Error + Send + Sync + 'static)) -> bool {
    let error = error.downcast_ref::<io::Error>();
    error.is_some_and(|error| error.kind() == io::ErrorKind::BrokenPipe)
}

/// Argument number `at`, counted from 1, or what stands for it.
pub(crate) fn argument<T: FromStr>(at: usize, default: T) -> Outcome<T> {
    let Some(text) = std::env::args().nth(at) else {
        return Ok(default);
    };
    let wrong = |_| format!("argument {at} is {text:?}: give a {}", type_name::<T>());
    text.parse().map_err(|error| wrong(error).into())
}

/// A descriptor that becomes readable on Ctrl-C, which ends the program no longer. To be
/// made before any thread is, since each thread has a signal mask of its own.
pub(crate) fn interrupts() -> io::Result<SignalFd> {
    let mut mask = SigSet::empty();
    mask.add(Signal::SIGINT);
    mask.thread_block()?;
    Ok(SignalFd::with_flags(&mask, SfdFlags::SFD_CLOEXEC)?)
}

/// A descriptor that becomes readable once in each `period`; reading it ends that.
pub(crate) fn every(period: Duration) -> io::Result<TimerFd> {
    let timer = TimerFd::new(ClockId::CLOCK_MONOTONIC, TimerFlags::TFD_CLOEXEC)?;
    let expiration = Expiration::Interval(TimeSpec::from_duration(period));
    timer.set(expiration, TimerSetTimeFlags::empty())?;
    Ok(timer)
}
