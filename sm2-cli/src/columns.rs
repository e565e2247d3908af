//! Tables for people. Each column is as wide as its longest cell.
//!
//! A growing table repeats its headings when a column becomes wider. No crate offers that, and complete tables share
//! its few lines.

use std::{fmt, marker::PhantomData};

/// A column of a table: its heading, and its cell in a row.
pub(crate) type Column<R> = (&'static str, fn(&R) -> String);

/// A value as a cell, or `-` if it is not known.
pub(crate) fn cell(value: Option<impl ToString>) -> String {
    value.map_or_else(|| "-".to_owned(), |value| value.to_string())
}

/// A number with this number of decimals as a cell, or `-` if it is not known.
pub(crate) fn number(value: Option<f64>, decimals: usize) -> String {
    cell(value.map(|value| format!("{value:.decimals$}")))
}

/// A row of a table.
pub(crate) trait Row: Sized + 'static {
    /// The columns, from left to right.
    const COLUMNS: &'static [Column<Self>];
}

/// A table of rows that are all known.
pub(crate) struct Table<'a, R>(pub(crate) &'a [R]);

impl<R: Row> fmt::Display for Table<'_, R> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let headings = [headings::<R>()];
        let rows: Vec<_> = headings.into_iter().chain(cells(self.0)).collect();
        write_table(f, &rows)
    }
}

/// A table that grows while a command runs. The headings are printed again when a column becomes wider.
#[derive(Clone, Debug)]
pub(crate) struct Stream<R> {
    numeric: Vec<bool>,
    widths: Vec<usize>,
    printed: bool,
    row: PhantomData<R>,
}

impl<R: Row> Stream<R> {
    /// The first `texts` columns hold texts, the others numbers.
    pub(crate) fn new(texts: usize) -> Self {
        let headings = headings::<R>();
        Self {
            // Wide enough for usual numbers, so that headings are rarely repeated.
            widths: headings
                .iter()
                .map(|it| it.chars().count().max(8))
                .collect(),
            numeric: (0..headings.len()).map(|at| at >= texts).collect(),
            printed: false,
            row: PhantomData,
        }
    }

    /// The lines of more rows.
    pub(crate) fn lines(&mut self, rows: &[R]) -> Vec<String> {
        let rows: Vec<_> = cells(rows).collect();
        let needed = widths(&rows);
        let mut lines = Vec::new();
        let is_wider = needed
            .iter()
            .zip(&self.widths)
            .any(|(need, have)| need > have);
        if is_wider || !self.printed {
            for (have, need) in self.widths.iter_mut().zip(needed) {
                *have = need.max(*have);
            }
            self.printed = true;
            lines.push(line(&headings::<R>(), &self.widths, &self.numeric));
        }
        lines.extend(
            rows.iter()
                .map(|row| line(row, &self.widths, &self.numeric)),
        );
        lines
    }
}

fn headings<R: Row>() -> Vec<String> {
    R::COLUMNS
        .iter()
        .map(|(heading, _)| String::from(*heading))
        .collect()
}

fn cells<R: Row>(rows: &[R]) -> impl Iterator<Item = Vec<String>> {
    rows.iter()
        .map(|row| R::COLUMNS.iter().map(|(_, cell)| cell(row)).collect())
}

/// Writes rows; the first one is that of the headings. Columns of numbers are aligned right, all others left. A
/// `-` stands for an unknown number.
fn write_table(f: &mut fmt::Formatter<'_>, rows: &[Vec<String>]) -> fmt::Result {
    let widths = widths(rows);
    let numeric = numeric(&rows[1..], widths.len());
    for (at, row) in rows.iter().enumerate() {
        let line_break = if at == 0 { "" } else { "\n" };
        write!(f, "{line_break}{}", line(row, &widths, &numeric))?;
    }
    Ok(())
}

fn widths(rows: &[Vec<String>]) -> Vec<usize> {
    let columns = rows.first().map_or(0, |row| row.len());
    let width = |column: usize| {
        let cells = rows.iter().map(|row| row[column].chars().count());
        cells.max().unwrap_or(0)
    };
    (0..columns).map(width).collect()
}

/// Whether each column holds only numbers. The first column names the rows and is never one of numbers.
fn numeric(rows: &[Vec<String>], columns: usize) -> Vec<bool> {
    let is_number = |cell: &str| {
        let mut bytes = cell.bytes();
        cell == "-" || bytes.all(|byte| byte.is_ascii_digit() || byte == b'.')
    };
    let numbers = |column: usize| rows.iter().all(|row| is_number(&row[column]));
    (0..columns)
        .map(|column| column > 0 && numbers(column))
        .collect()
}

fn line(row: &[String], widths: &[usize], numeric: &[bool]) -> String {
    let cells = row.iter().zip(widths).zip(numeric);
    let cells = cells.map(|((cell, width), numeric)| match numeric {
        true => format!("{cell:>width$}"),
        false => format!("{cell:<width$}"),
    });
    cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
}

#[cfg(test)]
mod tests;
