//! The reasons why a parameter does not get a value.

use super::limits::{NAME_MAX, PARAMETERS_MAX, TABLE_MAX, TEXT_MAX, VALUE_MAX};
use super::range::Range;
use super::value::Kind;

/// A request to set parameters was refused. No parameter has changed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Refusal {
    /// The node has not declared such a parameter.
    #[error("this node has no parameter {name:?}: `sm2 param list` shows those that it has")]
    Unknown {
        /// The name, or the beginning of a long one.
        name: String,
    },
    /// The request has two values for one parameter.
    #[error("the request has two values for {name}: name each parameter once")]
    Twice {
        /// The name of the parameter.
        name: String,
    },
    /// The program declared the parameter as read-only.
    #[error(
        "{name} is read-only: set it in a file or the environment, and start the program again"
    )]
    ReadOnly {
        /// The name of the parameter.
        name: String,
    },
    /// The value has another type than the parameter.
    #[error("{name} has the type {expected}, but the value has the type {found}")]
    WrongType {
        /// The name of the parameter.
        name: String,
        /// The type of the parameter.
        expected: Kind,
        /// The type of the value.
        found: Kind,
    },
    /// The value is outside of the range.
    #[error("{name} is {range}, but the value is {value}")]
    OutOfRange {
        /// The name of the parameter.
        name: String,
        /// The value.
        value: String,
        /// The range of the parameter.
        range: Range,
    },
    /// The encoded value is longer than [`VALUE_MAX`].
    #[error("the value of {name} takes {len} bytes, but at most {VALUE_MAX} are possible")]
    TooLong {
        /// The name of the parameter.
        name: String,
        /// The length of the encoded value, in bytes.
        len: usize,
    },
    /// All parameters together would be longer than [`TABLE_MAX`].
    #[error("all parameters together would take {len} bytes, but at most {TABLE_MAX} are possible")]
    TableTooLong {
        /// The length of the encoded table, in bytes.
        len: usize,
    },
}

impl Refusal {
    /// Cuts a name that another process chose.
    pub(super) fn unknown(name: &str) -> Self {
        let name = cut(name.to_owned(), NAME_MAX);
        Self::Unknown { name }
    }
}

/// Cuts a text off, between two characters, so that it has at most `max_len` bytes.
pub(super) fn cut(mut text: String, max_len: usize) -> String {
    let end = (0..=max_len.min(text.len())).rfind(|&at| text.is_char_boundary(at));
    text.truncate(end.unwrap_or(0));
    text
}

/// A text is not the name of a parameter.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum NameProblem {
    /// It is longer than [`NAME_MAX`].
    #[error("the name has {len} bytes, but at most {NAME_MAX} are possible")]
    TooLong {
        /// The length, in bytes.
        len: usize,
    },
    /// A segment is empty, or has another character.
    #[error(
        "a name consists of segments of A-Z a-z 0-9 _ - joined by single dots, but one is {segment:?}"
    )]
    Segment {
        /// The segment.
        segment: String,
    },
}

/// A table of another process breaks a rule.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WrongTable {
    /// It has more than [`PARAMETERS_MAX`] parameters.
    #[error("the table has {count} parameters, but at most {PARAMETERS_MAX} are possible")]
    TooMany {
        /// The number of parameters.
        count: usize,
    },
    /// A name is not legal.
    #[error(transparent)]
    Name(NameProblem),
    /// Two parameters have one name.
    #[error("the table has two parameters {name}")]
    Twice {
        /// The name.
        name: String,
    },
    /// A description is longer than [`TEXT_MAX`].
    #[error("the description of {name} has more than {TEXT_MAX} bytes")]
    Description {
        /// The name of the parameter.
        name: String,
    },
    /// A range has no values.
    #[error("the range of {name} is empty or not finite")]
    Range {
        /// The name of the parameter.
        name: String,
    },
    /// A value is outside of its own range, or too long.
    #[error(transparent)]
    Value(Refusal),
}
