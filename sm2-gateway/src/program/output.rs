//! Standard output.

use std::{fmt::Display, io::Write};

use serde::Serialize;

use super::error::ProgramError;

/// Writes a line to standard output.
pub(super) fn write_line(out: &mut impl Write, line: impl Display) -> Result<(), ProgramError> {
    writeln!(out, "{line}").map_err(ProgramError::system("write to standard output"))
}

/// Writes an answer as one line of JSON, or as text.
pub(super) fn write_answer(
    out: &mut impl Write,
    json: bool,
    answer: &(impl Display + Serialize),
) -> Result<(), ProgramError> {
    match json {
        true => write_line(out, serde_json::json!(answer)),
        false => write_line(out, answer),
    }
}
