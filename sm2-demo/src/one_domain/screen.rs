//! Where the demo's figures appear.

use std::io::Write;

use super::{
    child::Child,
    meter::{Cost, Meter},
    report::Report,
    table::{self, Row},
};
use crate::{error::DemoError, options::Format, output::write_json};

/// With more lines than this a table may not fit a terminal, and could not be redrawn.
const REDRAWN_LINES: usize = 20;

/// Standard output: a table that is redrawn, a line each second, or nothing but the report.
pub(crate) struct Screen<'a> {
    out: &'a mut dyn Write,
    format: Format,
    /// How many lines of a table are above the cursor.
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

    /// What the demo is about to do.
    ///
    /// # Errors
    ///
    /// [`DemoError::Output`], as all of these.
    pub(crate) fn announce(&mut self, text: &str) -> Result<(), DemoError> {
        if self.format != Format::Json {
            writeln!(self.out, "{text}")?;
        }
        Ok(self.out.flush()?)
    }

    /// The figures of this second.
    pub(crate) fn show(
        &mut self,
        children: &[Child],
        meter: &Meter,
        costs: &[Cost],
    ) -> Result<(), DemoError> {
        if self.format == Format::Json {
            return Ok(());
        }
        let rows = rows(children, costs);
        let table = table::table(&rows);
        if self.format == Format::Terminal && table.len() <= REDRAWN_LINES {
            self.erase()?;
            self.drawn = table.len();
            for line in table {
                writeln!(self.out, "{line}")?;
            }
        } else {
            writeln!(self.out, "{}", table::line(meter.elapsed(), &rows))?;
        }
        Ok(self.out.flush()?)
    }

    /// The end.
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

    /// Takes the last table away.
    fn erase(&mut self) -> Result<(), DemoError> {
        match std::mem::take(&mut self.drawn) {
            0 => Ok(()),
            // Up to its first line, and clear from there.
            lines => Ok(write!(self.out, "\x1b[{lines}A\x1b[J")?),
        }
    }
}

/// The parts, then the Manager: as the meter has them.
fn rows(children: &[Child], costs: &[Cost]) -> Vec<Row> {
    let parts = children
        .iter()
        .map(|child| Some((child.part(), child.figures())));
    let rows = parts.chain([None]).zip(costs);
    rows.map(|(part, &cost)| Row { part, cost }).collect()
}
