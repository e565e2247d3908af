//! Messages for people, on standard error.

use std::{
    fmt,
    io::{self, Write},
    mem,
    sync::{Mutex, MutexGuard, PoisonError},
};

use crate::{
    colours::{self, Meaning},
    printable::printable,
};

/// Moves to the start of the line, and erases it.
const ERASE: &str = "\r\x1b[2K";

/// Whether the last line shows the progress of work, and the next message takes its place.
static SHOWS_PROGRESS: Mutex<bool> = Mutex::new(false);

/// Locked while a line is written: threads write whole lines, the progress and messages that replace it.
fn shows_progress() -> MutexGuard<'static, bool> {
    let locked = SHOWS_PROGRESS.lock();
    locked.unwrap_or_else(PoisonError::into_inner)
}

/// Like `eprintln!`, but does not panic if the reader of standard error is gone, as in `sm2 … 2>&1 | head`.
macro_rules! stderr_line {
    ($($argument:tt)*) => {
        $crate::stderr::line(&format!($($argument)*))
    };
}

/// Writes a line.
pub(crate) fn line(line: &str) {
    write(format_args!("{}\n", printable(line)), false);
}

/// Writes the error that ends the command.
pub(crate) fn error(text: &str) {
    let text = printable(text);
    match colours::are_on_stderr() {
        true => write(
            format_args!("{} {text}\n", Meaning::Bad.paint("sm2:")),
            false,
        ),
        false => write(format_args!("sm2: {text}\n"), false),
    }
}

/// Shows the progress of work in a line of its own, which the next message replaces. Standard error is a terminal.
pub(crate) fn progress(line: &str) {
    write(format_args!("{ERASE}{}", printable(line)), true);
}

/// Ends the line that shows progress, if there is one: standard output may be the same terminal, and goes on below it.
pub(crate) fn end_progress() {
    if mem::take(&mut *shows_progress()) {
        let _ = writeln!(io::stderr());
    }
}

fn write(text: fmt::Arguments<'_>, is_progress: bool) {
    let mut shows_progress = shows_progress();
    let mut stderr = io::stderr().lock();
    if mem::replace(&mut *shows_progress, is_progress) {
        let _ = stderr.write_all(ERASE.as_bytes());
    }
    let _ = stderr.write_fmt(text);
}
