//! Where the demo's figures appear.

use super::{
    child::Child,
    meter::{Cost, Meter},
    report::Report,
    table::{self, Row},
};
use crate::{error::CliError, output::Output};

/// With more lines than this a table may not fit a terminal, and could not be redrawn.
const REDRAWN_LINES: usize = 20;

/// Standard output: a table that is redrawn, a line each second, or nothing but the report.
pub(super) struct Screen {
    out: Output,
    json: bool,
    /// How many lines of a table are above the cursor.
    drawn: usize,
}

impl Screen {
    pub(super) fn new(json: bool) -> Self {
        Self {
            out: Output::new(),
            json,
            drawn: 0,
        }
    }

    /// What the demo is about to do.
    ///
    /// # Errors
    ///
    /// [`CliError::Output`], as all of these.
    pub(super) fn announce(&mut self, text: &str) -> Result<(), CliError> {
        if !self.json {
            self.out.line(text)?;
        }
        self.out.flush()
    }

    /// The figures of this second.
    pub(super) fn show(
        &mut self,
        children: &[Child],
        meter: &Meter,
        costs: &[Cost],
    ) -> Result<(), CliError> {
        if self.json {
            return Ok(());
        }
        let rows = rows(children, costs);
        let table = table::table(&rows);
        if self.out.is_terminal() && table.len() <= REDRAWN_LINES {
            self.erase()?;
            self.drawn = table.len();
            for line in table {
                self.out.line(line)?;
            }
        } else {
            self.out.line(table::line(meter.elapsed(), &rows))?;
        }
        self.out.flush()
    }

    /// The end.
    pub(super) fn report(&mut self, report: &Report) -> Result<(), CliError> {
        if self.json {
            self.out.json(report)?;
            return self.out.flush();
        }
        self.erase()?;
        for line in table::summary(report) {
            self.out.line(line)?;
        }
        self.out.flush()
    }

    /// Takes the last table away.
    fn erase(&mut self) -> Result<(), CliError> {
        match std::mem::take(&mut self.drawn) {
            0 => Ok(()),
            // Up to its first line, and clear from there.
            lines => self.out.write(|out| {
                use std::io::Write;
                write!(out, "\x1b[{lines}A\x1b[J")
            }),
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
