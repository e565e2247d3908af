//! The values of parameters, and the types of Rust that they have.

use serde::{Deserialize, Serialize};

use crate::Schema;

/// The value of a parameter. The variants are the types that ROS 2 has.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[serde(rename_all = "snake_case")]
pub enum Value {
    /// `true` or `false`.
    Bool(bool),
    /// A signed integer of 64 bits.
    Integer(i64),
    /// A floating-point number of 64 bits.
    Double(f64),
    /// A text.
    String(String),
    /// Bytes.
    ByteArray(Vec<u8>),
    /// A list of truth values.
    BoolArray(Vec<bool>),
    /// A list of integers.
    IntegerArray(Vec<i64>),
    /// A list of floating-point numbers.
    DoubleArray(Vec<f64>),
    /// A list of texts.
    StringArray(Vec<String>),
}

/// The type of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// The type of [`Value::Bool`].
    Bool,
    /// The type of [`Value::Integer`].
    Integer,
    /// The type of [`Value::Double`].
    Double,
    /// The type of [`Value::String`].
    String,
    /// The type of [`Value::ByteArray`].
    ByteArray,
    /// The type of [`Value::BoolArray`].
    BoolArray,
    /// The type of [`Value::IntegerArray`].
    IntegerArray,
    /// The type of [`Value::DoubleArray`].
    DoubleArray,
    /// The type of [`Value::StringArray`].
    StringArray,
}

impl Kind {
    /// All types, in the order of [`Value`].
    pub const ALL: [Self; 9] = [
        Self::Bool,
        Self::Integer,
        Self::Double,
        Self::String,
        Self::ByteArray,
        Self::BoolArray,
        Self::IntegerArray,
        Self::DoubleArray,
        Self::StringArray,
    ];

    /// The name of the type, such as `double` and `double[]`.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Self::Bool => "bool",
            Self::Integer => "integer",
            Self::Double => "double",
            Self::String => "string",
            Self::ByteArray => "byte[]",
            Self::BoolArray => "bool[]",
            Self::IntegerArray => "integer[]",
            Self::DoubleArray => "double[]",
            Self::StringArray => "string[]",
        }
    }
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.word())
    }
}

impl Value {
    /// The type of the value.
    #[must_use]
    pub const fn kind(&self) -> Kind {
        match self {
            Self::Bool(_) => Kind::Bool,
            Self::Integer(_) => Kind::Integer,
            Self::Double(_) => Kind::Double,
            Self::String(_) => Kind::String,
            Self::ByteArray(_) => Kind::ByteArray,
            Self::BoolArray(_) => Kind::BoolArray,
            Self::IntegerArray(_) => Kind::IntegerArray,
            Self::DoubleArray(_) => Kind::DoubleArray,
            Self::StringArray(_) => Kind::StringArray,
        }
    }
}

/// A type of Rust that a parameter can have. Only types of this crate implement it.
///
/// | type | type of the parameter |
/// | --- | --- |
/// | `bool`, `i64`, `f64`, `String` | `bool`, `integer`, `double`, `string` |
/// | `Vec<u8>` | `byte[]` |
/// | `Vec<bool>`, `Vec<i64>`, `Vec<f64>`, `Vec<String>` | `bool[]`, `integer[]`, `double[]`, `string[]` |
pub trait ParameterType: sealed::OfValue + Clone + Send + Sync + 'static {
    /// The type of the parameter.
    const KIND: Kind;
}

pub(super) mod sealed {
    /// The conversions between a type and [`Value`](super::Value).
    pub trait OfValue: Sized {
        fn into_value(self) -> super::Value;

        /// `None` for a value of another type.
        fn of_value(value: &super::Value) -> Option<&Self>;
    }
}

macro_rules! parameter_types {
    ($($type:ty = $variant:ident;)*) => {
        $(
            impl sealed::OfValue for $type {
                fn into_value(self) -> Value {
                    Value::$variant(self)
                }

                fn of_value(value: &Value) -> Option<&Self> {
                    match value {
                        Value::$variant(value) => Some(value),
                        _ => None,
                    }
                }
            }

            impl ParameterType for $type {
                const KIND: Kind = Kind::$variant;
            }

            impl From<$type> for Value {
                fn from(value: $type) -> Self {
                    Self::$variant(value)
                }
            }
        )*
    };
}

parameter_types! {
    bool = Bool;
    i64 = Integer;
    f64 = Double;
    String = String;
    Vec<u8> = ByteArray;
    Vec<bool> = BoolArray;
    Vec<i64> = IntegerArray;
    Vec<f64> = DoubleArray;
    Vec<String> = StringArray;
}
