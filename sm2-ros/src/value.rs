//! Decoded messages.

use std::borrow::Cow;

use serde_json::{Map, Number};

/// A value of a decoded message.
#[derive(Clone, Debug, PartialEq)]
pub enum Value<'a> {
    /// `bool`
    Bool(bool),
    /// An unsigned integer, `byte` or `char`.
    Unsigned(u64),
    /// A signed integer.
    Signed(i64),
    /// `float32`
    F32(f32),
    /// `float64`
    F64(f64),
    /// `string` or `wstring`
    Text(Cow<'a, str>),
    /// An array or a sequence.
    List {
        /// The first elements.
        items: Vec<Self>,
        /// The number of elements behind them, which are not kept.
        more: u64,
    },
    /// A message, with the names of its fields.
    Struct(Vec<(&'a str, Self)>),
}

impl Value<'_> {
    /// The value as JSON. Numbers that JSON does not have are the texts `NaN`, `inf` and `-inf`. Elements that were
    /// not kept are missing.
    #[must_use]
    pub fn to_json(&self) -> serde_json::Value {
        use serde_json::Value as Json;
        let float = |number: f64| match Number::from_f64(number) {
            Some(number) => Json::Number(number),
            None => Json::String(number.to_string()),
        };
        match self {
            Self::Bool(value) => Json::Bool(*value),
            Self::Unsigned(number) => Json::from(*number),
            Self::Signed(number) => Json::from(*number),
            Self::F32(number) => float(f64::from(*number)),
            Self::F64(number) => float(*number),
            Self::Text(text) => Json::from(&**text),
            Self::List { items, .. } => items.iter().map(Value::to_json).collect(),
            Self::Struct(fields) => {
                let fields = fields.iter();
                let fields = fields.map(|(name, value)| (String::from(*name), value.to_json()));
                Json::Object(fields.collect::<Map<_, _>>())
            }
        }
    }
}
