//! A decoded message.

use std::borrow::Cow;

use serde::{
    Serialize, Serializer,
    ser::{SerializeMap as _, SerializeSeq as _},
};

/// A value of any type. Its JSON is described in [`super`].
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value<'a> {
    /// An empty structure.
    Unit,
    /// An absent value.
    Absent,
    Bool(bool),
    Unsigned(u64),
    Signed(i64),
    /// A whole number of more than 64 bits, in decimal.
    Digits(String),
    F32(f32),
    F64(f64),
    Char(char),
    Text(Cow<'a, str>),
    /// An array, a list, a set or a tuple.
    List {
        items: Vec<Self>,
        /// The number of further elements that were not kept.
        more: u64,
    },
    Map {
        entries: Vec<(Self, Self)>,
        /// The number of further elements that were not kept.
        more: u64,
    },
    Struct(Vec<(Cow<'a, str>, Self)>),
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
pub(super) fn more(count: u64) -> String {
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
