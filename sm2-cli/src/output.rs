//! Standard output, buffered, with errors as [`CliError`].

use std::{
    fmt,
    io::{self, BufWriter, IsTerminal, StdoutLock, Write},
    os::fd::{AsFd, BorrowedFd},
    sync::OnceLock,
};

use serde::Serialize;

use crate::{
    error::CliError,
    printable::{printable, printable_json},
};

/// The error of an output that could not be written out as it was dropped.
static UNWRITTEN: OnceLock<io::Error> = OnceLock::new();

/// Whether all output of a command that has ended was written.
///
/// # Errors
///
/// [`CliError::Output`], with the first error.
pub(crate) fn written() -> Result<(), CliError> {
    match UNWRITTEN.get() {
        None => Ok(()),
        Some(error) => Err(CliError::Output(io::Error::new(error.kind(), error))),
    }
}

/// Standard output, locked for as long as a command runs. Its buffer is written out when it is dropped: an error is
/// that of the [command](written).
pub(crate) struct Output(BufWriter<StdoutLock<'static>>);

impl Output {
    pub(crate) fn new() -> Self {
        Self(BufWriter::new(io::stdout().lock()))
    }

    /// Whether standard output is a terminal.
    pub(crate) fn is_terminal(&self) -> bool {
        self.0.get_ref().is_terminal()
    }

    /// Standard output for code that maps its own errors.
    pub(crate) fn writer(&mut self) -> &mut dyn Write {
        &mut self.0
    }

    /// Writes with `write`.
    ///
    /// # Errors
    ///
    /// [`CliError::Output`], as for the methods below.
    pub(crate) fn write(
        &mut self,
        write: impl FnOnce(&mut BufWriter<StdoutLock<'static>>) -> io::Result<()>,
    ) -> Result<(), CliError> {
        write(&mut self.0).map_err(CliError::Output)
    }

    /// Writes a line, with [escapes](printable) where it has control characters.
    pub(crate) fn line(&mut self, line: impl fmt::Display) -> Result<(), CliError> {
        let line = line.to_string();
        self.write(|out| writeln!(out, "{}", printable(&line)))
    }

    /// Writes a value as one line of JSON.
    pub(crate) fn json(&mut self, value: &impl Serialize) -> Result<(), CliError> {
        self.write(|out| {
            let json = serde_json::to_string(value)?;
            writeln!(out, "{}", printable_json(&json))
        })
    }

    /// Writes the buffer out now, because more comes later or never.
    pub(crate) fn flush(&mut self) -> Result<(), CliError> {
        self.write(Write::flush)
    }
}

impl AsFd for Output {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.get_ref().as_fd()
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        if let Err(error) = self.0.flush() {
            // The first error is the reason of all others.
            let _ = UNWRITTEN.set(error);
        }
    }
}
