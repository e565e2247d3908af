//! The notation of values: that of TOML, in files, in the environment and on the command line.

use std::fmt::{self, Write as _};

use toml::de::DeValue;

use super::value::{Kind, Value};

/// A text or a part of a file is not a value of the parameter's type.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum WrongValue {
    /// It is a value of another type.
    #[error("{expected} is expected{}, but this is {found}", example(*.expected))]
    Type {
        /// The type of the parameter.
        expected: Kind,
        /// The type in the words of TOML.
        found: &'static str,
    },
    /// It is not a value of TOML.
    #[error("{expected} is expected{}, but this is none: {reason}", example(*.expected))]
    Syntax {
        /// The type of the parameter.
        expected: Kind,
        /// The fault.
        reason: String,
    },
    /// It is a number that the type cannot hold.
    #[error("{number} does not fit into {expected}")]
    Number {
        /// The type of the parameter.
        expected: Kind,
        /// The number.
        number: String,
    },
}

const fn example(kind: Kind) -> &'static str {
    match kind {
        Kind::Bool => " (true or false)",
        Kind::Integer => " (such as 3)",
        Kind::Double => " (such as 2.5)",
        Kind::String => " (such as \"text\")",
        Kind::ByteArray => " (such as [0, 255])",
        Kind::BoolArray => " (such as [true, false])",
        Kind::IntegerArray => " (such as [1, 2])",
        Kind::DoubleArray => " (such as [0.5, 1.0])",
        Kind::StringArray => " (such as [\"a\", \"b\"])",
    }
}

impl Kind {
    /// Reads a value of this type from a text: an environment variable or an argument of a command. A `string` is the
    /// text itself, and all other values are written as in TOML. An integer is a `double`, too.
    ///
    /// # Errors
    ///
    /// See [`WrongValue`].
    pub fn parse(self, text: &str) -> Result<Value, WrongValue> {
        if self == Self::String {
            return Ok(Value::String(text.to_owned()));
        }
        let value = DeValue::parse(text.trim()).map_err(|error| WrongValue::Syntax {
            expected: self,
            reason: error.message().to_owned(),
        })?;
        self.read(&Literal::new(value.get_ref()))
    }

    /// Converts a value of TOML.
    pub(super) fn read(self, literal: &Literal) -> Result<Value, WrongValue> {
        Ok(match self {
            Self::Bool => Value::Bool(self.bool(literal)?),
            Self::Integer => Value::Integer(self.integer(literal)?),
            Self::Double => Value::Double(self.double(literal)?),
            Self::String => Value::String(self.text(literal)?),
            Self::ByteArray => Value::ByteArray(self.list(literal, Self::integer)?),
            Self::BoolArray => Value::BoolArray(self.list(literal, Self::bool)?),
            Self::IntegerArray => Value::IntegerArray(self.list(literal, Self::integer)?),
            Self::DoubleArray => Value::DoubleArray(self.list(literal, Self::double)?),
            Self::StringArray => Value::StringArray(self.list(literal, Self::text)?),
        })
    }

    fn list<T>(
        self,
        literal: &Literal,
        read: impl Fn(Self, &Literal) -> Result<T, WrongValue>,
    ) -> Result<Vec<T>, WrongValue> {
        match literal {
            Literal::List(list) => list.iter().map(|it| read(self, it)).collect(),
            other => Err(self.wrong(other)),
        }
    }

    fn bool(self, literal: &Literal) -> Result<bool, WrongValue> {
        match literal {
            Literal::Bool(value) => Ok(*value),
            other => Err(self.wrong(other)),
        }
    }

    fn text(self, literal: &Literal) -> Result<String, WrongValue> {
        match literal {
            Literal::Text(text) => Ok(text.clone()),
            other => Err(self.wrong(other)),
        }
    }

    /// An integer of any width.
    fn integer<T: TryFrom<i64>>(self, literal: &Literal) -> Result<T, WrongValue> {
        let Literal::Integer { digits, radix } = literal else {
            return Err(self.wrong(literal));
        };
        let value = i64::from_str_radix(digits, *radix).ok();
        value
            .and_then(|it| T::try_from(it).ok())
            .ok_or_else(|| self.number(digits))
    }

    /// An integer has to be one that a `double` holds exactly.
    fn double(self, literal: &Literal) -> Result<f64, WrongValue> {
        match literal {
            Literal::Integer { .. } => {
                let integer: i64 = self.integer(literal)?;
                match integer.unsigned_abs() <= EXACT_MAX {
                    true => Ok(integer as f64),
                    false => Err(self.number(&integer.to_string())),
                }
            }
            Literal::Float(text) => {
                let named = text.contains("inf") || text.contains("nan");
                let value: Option<f64> = text.parse().ok();
                let fits = value.filter(|it| it.is_finite() || named);
                fits.ok_or_else(|| self.number(text))
            }
            other => Err(self.wrong(other)),
        }
    }

    fn number(self, number: &str) -> WrongValue {
        WrongValue::Number {
            expected: self,
            number: number.to_owned(),
        }
    }

    const fn wrong(self, literal: &Literal) -> WrongValue {
        WrongValue::Type {
            expected: self,
            found: literal.description(),
        }
    }
}

/// All integers up to this one are numbers of the type `f64`.
const EXACT_MAX: u64 = 1 << f64::MANTISSA_DIGITS;

/// A value of TOML, before the type of its parameter is known.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Literal {
    Bool(bool),
    /// The digits, with a sign.
    Integer {
        digits: String,
        radix: u32,
    },
    Float(String),
    Text(String),
    List(Vec<Self>),
    /// A value that no parameter has.
    Other(&'static str),
}

impl Literal {
    pub(super) fn new(value: &DeValue<'_>) -> Self {
        match value {
            DeValue::Boolean(value) => Self::Bool(*value),
            DeValue::Integer(integer) => Self::Integer {
                digits: integer.as_str().to_owned(),
                radix: integer.radix(),
            },
            DeValue::Float(float) => Self::Float(float.as_str().to_owned()),
            DeValue::String(text) => Self::Text(text.to_string()),
            DeValue::Array(list) => {
                Self::List(list.iter().map(|it| Self::new(it.get_ref())).collect())
            }
            DeValue::Datetime(_) => Self::Other("a date or a time"),
            DeValue::Table(_) => Self::Other("a table"),
        }
    }

    const fn description(&self) -> &'static str {
        match self {
            Self::Bool(_) => "true or false",
            Self::Integer { .. } => "an integer",
            Self::Float(_) => "a number with a fraction",
            Self::Text(_) => "a text",
            Self::List(_) => "a list",
            Self::Other(description) => description,
        }
    }
}

/// The value as TOML writes it: `2.5`, `"text"`, `[1, 2]`.
impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bool(it) => write!(f, "{it}"),
            Self::Integer(it) => write!(f, "{it}"),
            Self::Double(it) => double(f, *it),
            Self::String(it) => quoted(f, it),
            Self::ByteArray(list) => written(f, list, |f, it| write!(f, "{it}")),
            Self::BoolArray(list) => written(f, list, |f, it| write!(f, "{it}")),
            Self::IntegerArray(list) => written(f, list, |f, it| write!(f, "{it}")),
            Self::DoubleArray(list) => written(f, list, |f, it| double(f, *it)),
            Self::StringArray(list) => written(f, list, |f, it| quoted(f, it)),
        }
    }
}

fn written<T>(
    f: &mut fmt::Formatter<'_>,
    list: &[T],
    write: impl Fn(&mut fmt::Formatter<'_>, &T) -> fmt::Result,
) -> fmt::Result {
    f.write_char('[')?;
    for (at, item) in list.iter().enumerate() {
        f.write_str(if at == 0 { "" } else { ", " })?;
        write(f, item)?;
    }
    f.write_char(']')
}

/// Rust writes a number that is not one as `NaN`, and all others as TOML does.
fn double(f: &mut fmt::Formatter<'_>, value: f64) -> fmt::Result {
    match value.is_nan() {
        true => f.write_str("nan"),
        false => write!(f, "{value:?}"),
    }
}

/// A basic string of TOML, in one line.
fn quoted(f: &mut fmt::Formatter<'_>, text: &str) -> fmt::Result {
    f.write_char('"')?;
    for character in text.chars() {
        match character {
            '"' | '\\' => write!(f, "\\{character}")?,
            '\n' => f.write_str("\\n")?,
            '\t' => f.write_str("\\t")?,
            '\r' => f.write_str("\\r")?,
            it if it.is_control() => write!(f, "\\u{:04X}", u32::from(it))?,
            it => f.write_char(it)?,
        }
    }
    f.write_char('"')
}
