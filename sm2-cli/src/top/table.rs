//! A table of `sm2 top`: its columns and cells, for people and as JSON.

use serde_json::{Map, Value};

use crate::{
    interfaces::{Type, type_cell},
    sampling::hundredths,
};

/// A table whose first column is the name.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Table {
    pub(super) columns: &'static [Column],
    pub(super) rows: Vec<Vec<Cell>>,
}

/// A column of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Column {
    pub(super) heading: &'static str,
    /// Its name in JSON.
    key: &'static str,
    /// The number of decimals that its numbers have.
    decimals: usize,
    /// On a narrow screen, the column with the lowest rank is left out first. See [`HELP`](super::HELP).
    pub(super) rank: u8,
    /// Whether its numbers are messages per second, which the sparkline adds up.
    is_rate: bool,
    /// Whether a number above 0 asks for attention.
    pub(super) is_loss: bool,
    /// Whether a number can be older than the interval. In JSON, a further member says whether it is.
    may_be_old: bool,
    /// The key of a column: while that one has only zeros, a screen does not show this one.
    shown_with: Option<&'static str>,
}

/// A cell.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Cell {
    Text(String),
    /// `None` if no interface has stated the type.
    Type(Option<Type>),
    /// `None` if the number is not known.
    Number(Option<f64>),
    /// A number of an earlier interval: there was no message in this one.
    Old(f64),
}

pub(super) const fn column(
    heading: &'static str,
    key: &'static str,
    decimals: usize,
    rank: u8,
) -> Column {
    Column {
        heading,
        key,
        decimals,
        rank,
        is_rate: false,
        is_loss: false,
        may_be_old: false,
        shown_with: None,
    }
}

pub(super) const fn rate(heading: &'static str, key: &'static str, rank: u8) -> Column {
    Column {
        is_rate: true,
        ..column(heading, key, 2, rank)
    }
}

pub(super) const fn loss(
    heading: &'static str,
    key: &'static str,
    decimals: usize,
    rank: u8,
) -> Column {
    Column {
        is_loss: true,
        ..column(heading, key, decimals, rank)
    }
}

/// The rank of a table's first column, which is never left out.
pub(super) const NAME: u8 = u8::MAX;

/// The sum of those of the two that are known.
pub(super) fn plus(one: Option<f64>, other: Option<f64>) -> Option<f64> {
    match (one, other) {
        (Some(one), Some(other)) => Some(one + other),
        (known, None) | (None, known) => known,
    }
}

impl Table {
    /// The columns for a screen. The column that sorts the rows is always among them.
    pub(super) fn shown_columns(&self, sort: usize) -> Vec<usize> {
        let is_shown = |&at: &usize| {
            let with = self.columns[at].shown_with;
            at == sort || with.is_none_or(|key| self.has_more_than_zero(key))
        };
        (0..self.columns.len()).filter(is_shown).collect()
    }

    fn has_more_than_zero(&self, key: &str) -> bool {
        let columns = self.columns.iter().enumerate();
        let mut of_key = columns.filter(|(_, column)| column.key == key);
        of_key.any(|(at, _)| {
            let mut cells = self.rows.iter().filter_map(|row| row.get(at));
            cells.any(|cell| matches!(cell, Cell::Number(Some(number)) if *number > 0.0))
        })
    }

    /// The messages per second of a row, in all its directions. `None` if they are not known.
    pub(super) fn rate(&self, row: &[Cell]) -> Option<f64> {
        let rates = self.columns.iter().zip(row).filter(|(it, _)| it.is_rate);
        rates.fold(None, |sum, (_, cell)| match cell {
            Cell::Number(number) => plus(sum, *number),
            Cell::Text(_) | Cell::Type(_) | Cell::Old(_) => sum,
        })
    }

    pub(super) fn json(&self) -> Value {
        let row = |row: &Vec<Cell>| {
            let mut members = Map::new();
            for (column, cell) in self.columns.iter().zip(row) {
                members.insert(column.key.to_owned(), column.json(cell));
                if column.may_be_old {
                    let is_old = matches!(cell, Cell::Old(_));
                    members.insert(format!("{}_old", column.key), is_old.into());
                }
            }
            Value::Object(members)
        };
        self.rows.iter().map(row).collect()
    }
}

impl Column {
    /// A number of this column can be older than the interval.
    pub(super) const fn that_ages(self) -> Self {
        Self {
            may_be_old: true,
            ..self
        }
    }

    #[cfg(test)]
    pub(super) const fn test(heading: &'static str, decimals: usize) -> Self {
        Self {
            is_rate: true,
            ..column(heading, heading, decimals, NAME)
        }
    }

    /// A screen shows this column only while the column `key` has a number above 0.
    pub(super) const fn shown_with(self, key: &'static str) -> Self {
        Self {
            shown_with: Some(key),
            ..self
        }
    }

    fn json(&self, cell: &Cell) -> Value {
        let (Cell::Number(Some(number)) | Cell::Old(number)) = cell else {
            return match cell {
                Cell::Text(text) => Value::from(text.as_str()),
                Cell::Type(data) => serde_json::json!(data),
                Cell::Number(_) | Cell::Old(_) => Value::Null,
            };
        };
        match self.decimals {
            0 => Value::from(number.round() as i64),
            1 | 2 => Value::from(hundredths(*number)),
            _ => Value::from(*number),
        }
    }

    /// A cell of this column as text.
    pub(super) fn show(&self, cell: &Cell) -> String {
        match cell {
            Cell::Text(text) => text.clone(),
            Cell::Type(data) => type_cell(data.as_ref()),
            Cell::Number(Some(number)) => format!("{number:.*}", self.decimals),
            Cell::Old(number) => format!("({number:.*})", self.decimals),
            Cell::Number(None) => "-".into(),
        }
    }
}

impl Cell {
    pub(super) fn as_text(&self) -> &str {
        match self {
            Self::Text(text) => text,
            Self::Type(data) => data.as_ref().map_or("-", |it| it.name.as_str()),
            Self::Number(_) | Self::Old(_) => "",
        }
    }

    /// Orders numbers from the largest to the smallest, unknown ones last, and texts alphabetically.
    pub(super) fn order(&self, other: &Self) -> std::cmp::Ordering {
        let value = |it: &Self| match it {
            Self::Text(_) | Self::Type(_) => None,
            Self::Number(number) => Some(number.unwrap_or(f64::NEG_INFINITY)),
            Self::Old(number) => Some(*number),
        };
        match (value(self), value(other)) {
            (None, None) => self.as_text().cmp(other.as_text()),
            (Some(one), Some(other)) => other.total_cmp(&one),
            (None, Some(_)) => std::cmp::Ordering::Less,
            (Some(_), None) => std::cmp::Ordering::Greater,
        }
    }
}
