//! Standard output, buffered, with errors as [`CliError`].

use std::{
    fmt,
    io::{self, BufWriter, IsTerminal, StdoutLock, Write},
    os::fd::{AsFd, BorrowedFd},
    sync::OnceLock,
};

use serde::Serialize;

use crate::{
    colours::{self, Meaning},
    columns::{Row, Table},
    error::CliError,
    printable::{printable, printable_json},
    stderr,
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
pub(crate) struct Output {
    buffer: BufWriter<StdoutLock<'static>>,
    has_colours: bool,
}

impl Output {
    pub(crate) fn new() -> Self {
        let stdout = io::stdout().lock();
        Self {
            has_colours: colours::are_on(&stdout),
            buffer: BufWriter::new(stdout),
        }
    }

    /// Whether standard output is a terminal.
    pub(crate) fn is_terminal(&self) -> bool {
        self.buffer.get_ref().is_terminal()
    }

    /// Standard output for code that maps its own errors.
    pub(crate) fn writer(&mut self) -> &mut dyn Write {
        &mut self.buffer
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
        stderr::end_progress();
        write(&mut self.buffer).map_err(CliError::Output)
    }

    /// Writes a line, with [escapes](printable) where it has control characters.
    pub(crate) fn line(&mut self, line: impl fmt::Display) -> Result<(), CliError> {
        let line = line.to_string();
        self.write(|out| writeln!(out, "{}", printable(&line)))
    }

    /// Writes a table below an empty line, if it has rows.
    pub(crate) fn table_below<R: Row>(&mut self, rows: &[R]) -> Result<(), CliError> {
        match rows {
            [] => Ok(()),
            rows => self.line(format_args!("\n{}", Table(rows))),
        }
    }

    /// Writes a line whose first `len` bytes have a meaning.
    pub(crate) fn meant(
        &mut self,
        meaning: Meaning,
        len: usize,
        line: impl fmt::Display,
    ) -> Result<(), CliError> {
        let line = line.to_string();
        let (meant, rest) = line.split_at_checked(len).unwrap_or((&line, ""));
        match self.has_colours {
            true => {
                let (meant, rest) = (printable(meant), printable(rest));
                self.write(|out| writeln!(out, "{}{rest}", meaning.paint(&meant)))
            }
            false => self.line(line),
        }
    }

    /// Writes a sentence about a link, in the colour of its meaning.
    pub(crate) fn sentence(&mut self, sentence: &str) -> Result<(), CliError> {
        match Meaning::of_sentence(sentence) {
            Some(meaning) => self.meant(meaning, sentence.len(), sentence),
            None => self.line(sentence),
        }
    }

    /// Writes a value as one line of JSON.
    pub(crate) fn json(&mut self, value: &impl Serialize) -> Result<(), CliError> {
        self.write(|out| {
            let json = serde_json::to_string(value)?;
            writeln!(out, "{}", printable_json(&json))
        })
    }

    /// Writes the answer of a command: as one line of JSON, or with `show` for people.
    pub(crate) fn answer(
        &mut self,
        json: bool,
        answer: &impl Serialize,
        show: impl FnOnce(&mut Self) -> Result<(), CliError>,
    ) -> Result<(), CliError> {
        match json {
            true => self.json(answer),
            false => show(self),
        }
    }

    /// Writes the buffer out now, because more comes later or never.
    pub(crate) fn flush(&mut self) -> Result<(), CliError> {
        self.write(Write::flush)
    }
}

impl AsFd for Output {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.buffer.get_ref().as_fd()
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        if let Err(error) = self.buffer.flush() {
            // The first error is the reason of all others.
            let _ = UNWRITTEN.set(error);
        }
    }
}
