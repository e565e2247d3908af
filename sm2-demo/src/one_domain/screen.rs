//! The output of the demo.

use std::{io::Write, time::Duration};

use super::{
    child::Child,
    meter::{Cost, Meter},
    report::Report,
    table::{self, Row},
};
use crate::{error::DemoError, options::Format, output::write_json};

/// The longest table that is redrawn: a longer one may not fit a terminal.
const REDRAWN_LINES: usize = 20;

/// The writer of a table that is redrawn, of a line each second, or of the report alone.
pub(crate) struct Screen<'a> {
    out: &'a mut dyn Write,
    format: Format,
    /// The number of lines of the table above the cursor.
    drawn: usize,
}

impl<'a> Screen<'a> {
    pub(crate) fn new(out: &'a mut dyn Write, format: Format) -> Self {
        Self {
            out,
            format,
            drawn: 0,
        }
    }

    /// Announces the run.
    ///
    /// # Errors
    ///
    /// [`DemoError::Output`], as for all methods of this type.
    pub(crate) fn announce(&mut self, text: &str) -> Result<(), DemoError> {
        if self.format != Format::Json {
            writeln!(self.out, "{text}")?;
        }
        Ok(self.out.flush()?)
    }

    /// Shows the figures of the last second.
    pub(crate) fn show(
        &mut self,
        children: &[Child],
        meter: &Meter,
        costs: &[Cost],
    ) -> Result<(), DemoError> {
        if self.format == Format::Json {
            return Ok(());
        }
        self.show_rows(meter.elapsed(), &rows(children, costs))
    }

    fn show_rows(&mut self, elapsed: Duration, rows: &[Row]) -> Result<(), DemoError> {
        let table = table::table(rows);
        if self.format == Format::Terminal && table.len() <= REDRAWN_LINES {
            self.erase()?;
            self.drawn = table.len();
            for line in table {
                writeln!(self.out, "{line}")?;
            }
        } else {
            writeln!(self.out, "{}", table::line(elapsed, rows))?;
        }
        Ok(self.out.flush()?)
    }

    /// Writes the report.
    pub(crate) fn report(&mut self, report: &Report) -> Result<(), DemoError> {
        if self.format == Format::Json {
            return write_json(self.out, report);
        }
        self.erase()?;
        for line in table::summary(report) {
            writeln!(self.out, "{line}")?;
        }
        Ok(self.out.flush()?)
    }

    /// Erases the last table.
    fn erase(&mut self) -> Result<(), DemoError> {
        match std::mem::take(&mut self.drawn) {
            0 => Ok(()),
            // Moves up to the first line of the table, and clears the screen from there.
            lines => Ok(write!(self.out, "\x1b[{lines}A\x1b[J")?),
        }
    }
}

/// The rows of the processes, then that of the Manager, in the order of the meter.
fn rows(children: &[Child], costs: &[Cost]) -> Vec<Row> {
    let parts = children
        .iter()
        .map(|child| Some((child.part(), child.figures())));
    let rows = parts.chain([None]).zip(costs);
    rows.map(|(part, &cost)| Row { part, cost }).collect()
}

#[cfg(test)]
mod tests;
