//! Standard output.

use std::{fmt::Display, io::Write};

use super::error::ProgramError;

/// Writes a line to standard output.
pub(super) fn write_line(out: &mut impl Write, line: impl Display) -> Result<(), ProgramError> {
    writeln!(out, "{line}").map_err(ProgramError::system("write to standard output"))
}
