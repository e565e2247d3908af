//! Tables for people: columns as wide as their longest cell.

use std::fmt;

/// A heading for each column, and rows of as many cells.
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

/// The first column starts on the left; numbers, which are all the others that have
/// nothing but digits, end on the right.
impl<const N: usize> fmt::Display for Columns<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = |column: usize| {
            let cells = self.rows.iter().map(|row| row[column].chars().count());
            cells.max().unwrap_or(0)
        };
        let widths: [usize; N] = std::array::from_fn(width);
        let numeric: [bool; N] = std::array::from_fn(|column| self.is_numeric(column));
        for (at, row) in self.rows.iter().enumerate() {
            let line: Vec<String> = (0..N)
                .map(|column| match numeric[column] {
                    true => format!("{:>1$}", row[column], widths[column]),
                    false => format!("{:<1$}", row[column], widths[column]),
                })
                .collect();
            let line_break = if at == 0 { "" } else { "\n" };
            write!(f, "{line_break}{}", line.join("  ").trim_end())?;
        }
        Ok(())
    }
}

impl<const N: usize> Columns<N> {
    fn is_numeric(&self, column: usize) -> bool {
        let mut cells = self.rows.iter().skip(1).map(|row| &row[column]);
        cells.all(|cell| cell.bytes().all(|byte| byte.is_ascii_digit()))
    }
}
