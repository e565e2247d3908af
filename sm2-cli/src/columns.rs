//! Tables for people. Each column is as wide as its longest cell.
//!
//! A growing table repeats its headings when a column becomes wider. No crate offers that, and complete tables share
//! its few lines.

use std::fmt;

/// A table whose rows are all known: a heading for each column, and rows with as many cells.
#[derive(Clone, Debug)]
pub(crate) struct Columns<const N: usize> {
    rows: Vec<[String; N]>,
}

impl<const N: usize> Columns<N> {
    pub(crate) fn new(headings: [&str; N]) -> Self {
        Self {
            rows: vec![headings.map(str::to_owned)],
        }
    }

    pub(crate) fn push(&mut self, row: [String; N]) {
        self.rows.push(row);
    }
}

/// Columns of numbers are aligned right, all others left. A `-` stands for an unknown number.
impl<const N: usize> fmt::Display for Columns<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let widths = widths(&self.rows);
        let numeric = numeric(&self.rows[1..]);
        for (at, row) in self.rows.iter().enumerate() {
            let line_break = if at == 0 { "" } else { "\n" };
            write!(f, "{line_break}{}", line(row, &widths, &numeric))?;
        }
        Ok(())
    }
}

/// A table that grows while a command runs. The headings are printed again when a column becomes wider.
#[derive(Clone, Debug)]
pub(crate) struct Stream<const N: usize> {
    headings: [String; N],
    numeric: [bool; N],
    widths: [usize; N],
    printed: bool,
}

impl<const N: usize> Stream<N> {
    /// The first `texts` columns hold texts, the others numbers.
    pub(crate) fn new(headings: [&str; N], texts: usize) -> Self {
        let headings = headings.map(str::to_owned);
        Self {
            // Wide enough for usual numbers, so that headings are rarely repeated.
            widths: std::array::from_fn(|at| headings[at].chars().count().max(8)),
            headings,
            numeric: std::array::from_fn(|at| at >= texts),
            printed: false,
        }
    }

    /// The lines of more rows.
    pub(crate) fn lines(&mut self, rows: &[[String; N]]) -> Vec<String> {
        let needed = widths(rows);
        let fits = needed
            .iter()
            .zip(&self.widths)
            .all(|(need, have)| need <= have);
        let mut lines = Vec::new();
        if !fits || !self.printed {
            for (have, need) in self.widths.iter_mut().zip(needed) {
                *have = need.max(*have);
            }
            self.printed = true;
            lines.push(line(&self.headings, &self.widths, &self.numeric));
        }
        lines.extend(
            rows.iter()
                .map(|row| line(row, &self.widths, &self.numeric)),
        );
        lines
    }
}

fn widths<const N: usize>(rows: &[[String; N]]) -> [usize; N] {
    std::array::from_fn(|column| {
        let cells = rows.iter().map(|row| row[column].chars().count());
        cells.max().unwrap_or(0)
    })
}

/// Whether each column holds only numbers. The first column names the rows and is never one of numbers.
fn numeric<const N: usize>(rows: &[[String; N]]) -> [bool; N] {
    let is_number = |cell: &str| {
        let mut bytes = cell.bytes();
        cell == "-" || bytes.all(|byte| byte.is_ascii_digit() || byte == b'.')
    };
    std::array::from_fn(|column| column > 0 && rows.iter().all(|row| is_number(&row[column])))
}

fn line<const N: usize>(row: &[String; N], widths: &[usize; N], numeric: &[bool; N]) -> String {
    let cells = row.iter().zip(widths).zip(numeric);
    let cells = cells.map(|((cell, width), numeric)| match numeric {
        true => format!("{cell:>width$}"),
        false => format!("{cell:<width$}"),
    });
    cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
}

#[cfg(test)]
mod tests;
