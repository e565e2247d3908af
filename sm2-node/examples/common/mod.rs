//! Shared parts of the examples: arguments, exit statuses, timers and signals.
#![allow(dead_code, reason = "each example uses its own part")]

use std::any::type_name;
use std::error::Error;
use std::io::{self, Write, stdout};
use std::process::{ExitCode, Termination};
use std::str::FromStr;
use std::time::Duration;

use nix::sys::signal::{SigSet, Signal};
use nix::sys::signalfd::{SfdFlags, SignalFd};
use nix::sys::time::TimeSpec;
use nix::sys::timerfd::{ClockId, Expiration, TimerFd, TimerFlags, TimerSetTimeFlags};
use sm2_node::Subscriber;

/// The result of an example, or of a part of one.
pub(crate) type Outcome<T = ()> = Result<T, Box<dyn Error + Send + Sync>>;

/// Exit status of a program that Ctrl-C ended, as shells expect it: 128 plus the signal's number.
pub(crate) const INTERRUPTED: u8 = 130;

/// The most messages that [`print_messages`] takes in one call, so that the loop's other events
/// are handled in between.
const BATCH: u64 = 64;

/// Runs an example, and prints its error as one line on standard error. A closed pipe
/// (`… | head`) is not an error.
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

/// Argument number `at`, counted from 1; `default` if it is missing.
pub(crate) fn argument<T: FromStr>(at: usize, default: T) -> Outcome<T> {
    let Some(text) = std::env::args().nth(at) else {
        return Ok(default);
    };
    let wrong = |_| format!("argument {at} is {text:?}: give a {}", type_name::<T>());
    text.parse().map_err(|error| wrong(error).into())
}

/// A descriptor that becomes readable on Ctrl-C. Ctrl-C no longer ends the program.
///
/// Call this before the first thread starts: threads inherit the signal mask that it sets.
pub(crate) fn interrupts() -> io::Result<SignalFd> {
    let mut mask = SigSet::empty();
    mask.add(Signal::SIGINT);
    mask.thread_block()?;
    Ok(SignalFd::with_flags(&mask, SfdFlags::SFD_CLOEXEC)?)
}

/// A descriptor that becomes readable once in each `period`, until it is read.
pub(crate) fn every(period: Duration) -> io::Result<TimerFd> {
    let timer = TimerFd::new(ClockId::CLOCK_MONOTONIC, TimerFlags::TFD_CLOEXEC)?;
    let expiration = Expiration::Interval(TimeSpec::from_duration(period));
    timer.set(expiration, TimerSetTimeFlags::empty())?;
    Ok(timer)
}

/// Prints the messages that have arrived, at most `limit` of them, and returns their number.
pub(crate) fn print_messages(subscriber: &Subscriber<str>, limit: u64) -> Outcome<u64> {
    let limit = limit.min(BATCH);
    for taken in 0..limit {
        match subscriber.try_recv()? {
            Some(sample) => writeln!(stdout(), "{} said: {}", sample.publisher(), &*sample)?,
            None => return Ok(taken),
        }
    }
    Ok(limit)
}
