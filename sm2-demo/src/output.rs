//! Forms of output that both demos share.

use std::io::{self, Write};

use bytesize::ByteSize;
use serde::Serialize;

use crate::error::DemoError;

/// Writes a report as one line of JSON.
pub(crate) fn write_json(out: &mut dyn Write, report: &impl Serialize) -> Result<(), DemoError> {
    serde_json::to_writer(&mut *out, report).map_err(io::Error::from)?;
    writeln!(out)?;
    Ok(out.flush()?)
}

/// The name of an integrity in reports and on command lines.
pub(crate) const fn integrity(is_sealed: bool) -> &'static str {
    if is_sealed { "sealed" } else { "pooled" }
}

/// A size for people: `10 MB`, `1.5 kB`.
pub(crate) fn size_text(bytes: u64) -> String {
    let text = ByteSize(bytes).display().si().to_string();
    text.replace(".0 ", " ")
}

#[cfg(test)]
mod tests;
