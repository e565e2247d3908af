//! Messages whose types are known at run time only: the values of their fields, and their JSON.
//!
//! | value | JSON |
//! | --- | --- |
//! | boolean, number, text | the same; `"NaN"`, `"inf"`, `"-inf"` and whole numbers of 128 bits as texts |
//! | list | array |
//! | structure | object; an empty one is `null` |
//! | variant | `"Name"`, or `{"Name": fields}` |
//! | map | object, if keys are texts, characters, whole numbers or booleans; else an array of pairs |
//!
//! The last element of a list or map that was kept in part is the text `… 9 more`.

use std::borrow::Cow;

use serde::{
    Serialize, Serializer,
    ser::{SerializeMap as _, SerializeSeq as _},
};
use serde_json::Value as Json;

/// A value of a decoded message.
///
/// Tools show messages of ROS 2 and of other schemas by one code, so there are values that no message of ROS 2 has:
/// [`decode`](crate::decode) returns none of the last six.
#[derive(Clone, Debug, PartialEq)]
pub enum Value<'a> {
    /// `bool`
    Bool(bool),
    /// An unsigned integer, `byte` or `char` of ROS 2.
    Unsigned(u64),
    /// A signed integer.
    Signed(i64),
    /// `float32`
    F32(f32),
    /// `float64`
    F64(f64),
    /// `string` or `wstring`
    Text(Cow<'a, str>),
    /// An array, a sequence, a set or a tuple.
    List {
        /// The first elements.
        items: Vec<Self>,
        /// The number of elements behind them, which are not kept.
        more: u64,
    },
    /// A message, with the names of its fields.
    Struct(Vec<(Cow<'a, str>, Self)>),
    /// A structure without fields.
    Unit,
    /// The value of an optional field that has none.
    Absent,
    /// A whole number of more than 64 bits, in decimal.
    Digits(String),
    /// A character.
    Char(char),
    /// Keys with their values.
    Map {
        /// The first entries.
        entries: Vec<(Self, Self)>,
        /// The number of entries behind them, which are not kept.
        more: u64,
    },
    /// A variant of an enumeration, with its name and fields.
    Variant(&'a str, Box<Self>),
}

impl Value<'_> {
    /// The value as a key of a JSON object, if it can be one.
    fn key(&self) -> Option<Cow<'_, str>> {
        Some(match self {
            Self::Text(text) => Cow::Borrowed(&**text),
            Self::Digits(digits) => Cow::Borrowed(&**digits),
            Self::Unsigned(number) => number.to_string().into(),
            Self::Signed(number) => number.to_string().into(),
            Self::Bool(value) => value.to_string().into(),
            Self::Char(c) => c.to_string().into(),
            _ => return None,
        })
    }
}

/// The text for elements that were left out: `… 9,990 more`.
#[must_use]
pub fn more(count: u64) -> String {
    let digits = count.to_string();
    let mut grouped = String::new();
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at).is_multiple_of(3) {
            grouped.push(',');
        }
        grouped.push(digit);
    }
    format!("… {grouped} more")
}

impl Serialize for Value<'_> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Unit | Self::Absent => to.serialize_unit(),
            Self::Bool(value) => to.serialize_bool(*value),
            Self::Unsigned(number) => to.serialize_u64(*number),
            Self::Signed(number) => to.serialize_i64(*number),
            Self::Digits(digits) => to.serialize_str(digits),
            // JSON has no NaN and no infinity.
            Self::F32(number) if !number.is_finite() => to.collect_str(number),
            Self::F64(number) if !number.is_finite() => to.collect_str(number),
            Self::F32(number) => to.serialize_f32(*number),
            Self::F64(number) => to.serialize_f64(*number),
            Self::Char(c) => to.serialize_char(*c),
            Self::Text(text) => to.serialize_str(text),
            Self::List { items, more: left } => {
                let mut seq = to.serialize_seq(None)?;
                for item in items {
                    seq.serialize_element(item)?;
                }
                if *left > 0 {
                    seq.serialize_element(&more(*left))?;
                }
                seq.end()
            }
            Self::Map {
                entries,
                more: left,
            } => serialize_map(entries, *left, to),
            Self::Struct(fields) => {
                to.collect_map(fields.iter().map(|(name, value)| (name, value)))
            }
            Self::Variant(name, fields) => match **fields {
                Self::Unit => to.serialize_str(name),
                _ => to.collect_map([(name, fields)]),
            },
        }
    }
}

fn serialize_map<S: Serializer>(
    entries: &[(Value<'_>, Value<'_>)],
    left: u64,
    to: S,
) -> Result<S::Ok, S::Error> {
    let keys: Option<Vec<_>> = entries.iter().map(|(key, _)| key.key()).collect();
    let Some(keys) = keys else {
        let mut seq = to.serialize_seq(None)?;
        for pair in entries {
            seq.serialize_element(pair)?;
        }
        if left > 0 {
            seq.serialize_element(&more(left))?;
        }
        return seq.end();
    };
    let mut map = to.serialize_map(None)?;
    for (key, (_, value)) in keys.iter().zip(entries) {
        map.serialize_entry(key, value)?;
    }
    if left > 0 {
        map.serialize_entry("…", &more(left))?;
    }
    map.end()
}

/// The number that JSON stands for, if it does for one.
#[must_use]
pub fn float(given: &Json) -> Option<f64> {
    match given {
        Json::String(text) => match text.as_str() {
            "NaN" => Some(f64::NAN),
            "inf" => Some(f64::INFINITY),
            "-inf" => Some(f64::NEG_INFINITY),
            _ => None,
        },
        other => other.as_f64(),
    }
}

/// JSON that does not fit a type, for an error: its kind, or its first 40 characters.
#[must_use]
pub fn found(given: &Json) -> String {
    const CHARS: usize = 40;
    let text = match given {
        Json::Array(_) => return "an array".to_owned(),
        Json::Object(_) => return "an object".to_owned(),
        scalar => scalar.to_string(),
    };
    match text.char_indices().nth(CHARS) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}
