//! Messages in JSON. They are shown as they are, even if they do not match the schema.

use std::{borrow::Cow, fmt};

use serde::{
    Deserializer,
    de::{DeserializeSeed, IgnoredAny, MapAccess, SeqAccess, Visitor},
};
use sm2_proto::schema::{Field, Scalar, Type};
use sm2_ros::Value;

use super::{
    error::{DecodeError, Wrong},
    shape::Shape,
};

/// Decodes a message in JSON. `serde_json` limits the depth.
pub(super) fn decode<'a>(
    ty: &'a Type,
    bytes: &'a [u8],
    keep: usize,
) -> Result<Value<'a>, DecodeError> {
    let text = str::from_utf8(bytes)
        .map_err(|error| DecodeError::new(error.valid_up_to(), Wrong::Utf8))?;
    let mut from = serde_json::Deserializer::from_str(text);
    let reader = Reader {
        meant: Meant::of(ty),
        keep,
    };
    let value = reader.deserialize(&mut from);
    let value = value.and_then(|value| from.end().map(|()| value));
    value.map_err(|error| DecodeError::Json(error.to_string()))
}

/// The parts of a value's schema that affect how JSON is read.
#[derive(Clone, Copy)]
enum Meant<'a> {
    /// A whole number that may have more than 64 bits.
    U128,
    I128,
    /// An array.
    List(&'a Type),
    /// An object whose names are the keys of a map.
    Map(&'a Type),
    Struct(&'a [Field]),
    Variant(&'a [sm2_proto::schema::Variant]),
    /// Any value.
    Anything,
}

impl<'a> Meant<'a> {
    fn of(ty: &'a Type) -> Self {
        match ty {
            Type::Scalar(Scalar::U128) => Self::U128,
            Type::Scalar(Scalar::I128) => Self::I128,
            Type::Array { element, .. } | Type::List(element) | Type::Set(element) => {
                Self::List(element)
            }
            Type::Map { value, .. } => Self::Map(value),
            Type::Struct(fields) => Self::of_fields(fields),
            Type::Enum(variants) => Self::Variant(variants),
            // `deserialize_u128` does not accept `null`.
            Type::Option(value) => match Self::of(value) {
                Self::U128 | Self::I128 => Self::Anything,
                value => value,
            },
            Type::Scalar(_) | Type::Text => Self::Anything,
        }
    }

    fn of_fields(fields: &'a [Field]) -> Self {
        match Shape::of(fields) {
            Shape::Single(ty) => Self::of(ty),
            _ => Self::Struct(fields),
        }
    }

    fn item(self, at: usize) -> Self {
        match self {
            Self::List(element) => Self::of(element),
            Self::Struct(fields) => {
                let field = fields.get(at);
                field.map_or(Self::Anything, |it| Self::of(it.ty()))
            }
            _ => Self::Anything,
        }
    }

    fn member(self, name: &str) -> Self {
        let found = match self {
            Self::Map(value) => Some(Self::of(value)),
            Self::Struct(fields) => {
                let field = fields.iter().find(|it| it.name() == name);
                field.map(|it| Self::of(it.ty()))
            }
            Self::Variant(variants) => {
                let variant = variants.iter().find(|it| it.name() == name);
                variant.map(|it| Self::of_fields(it.fields()))
            }
            _ => None,
        };
        found.unwrap_or(Self::Anything)
    }
}

#[derive(Clone, Copy)]
struct Reader<'a> {
    meant: Meant<'a>,
    /// The number of elements of a list that are kept.
    keep: usize,
}

impl<'a> Reader<'a> {
    const fn part(self, meant: Meant<'a>) -> Self {
        Self { meant, ..self }
    }
}

impl<'a> DeserializeSeed<'a> for Reader<'a> {
    type Value = Value<'a>;

    fn deserialize<D: Deserializer<'a>>(self, from: D) -> Result<Value<'a>, D::Error> {
        match self.meant {
            Meant::U128 => from.deserialize_u128(self),
            Meant::I128 => from.deserialize_i128(self),
            _ => from.deserialize_any(self),
        }
    }
}

impl<'a> Visitor<'a> for Reader<'a> {
    type Value = Value<'a>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value of JSON")
    }

    fn visit_unit<E>(self) -> Result<Value<'a>, E> {
        Ok(Value::Absent)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Value<'a>, E> {
        Ok(Value::Bool(value))
    }

    fn visit_u64<E>(self, number: u64) -> Result<Value<'a>, E> {
        Ok(Value::Unsigned(number))
    }

    fn visit_i64<E>(self, number: i64) -> Result<Value<'a>, E> {
        Ok(Value::Signed(number))
    }

    fn visit_u128<E>(self, number: u128) -> Result<Value<'a>, E> {
        Ok(Value::Digits(number.to_string()))
    }

    fn visit_i128<E>(self, number: i128) -> Result<Value<'a>, E> {
        Ok(Value::Digits(number.to_string()))
    }

    fn visit_f64<E>(self, number: f64) -> Result<Value<'a>, E> {
        Ok(Value::F64(number))
    }

    fn visit_borrowed_str<E>(self, text: &'a str) -> Result<Value<'a>, E> {
        Ok(Value::Text(text.into()))
    }

    fn visit_str<E>(self, text: &str) -> Result<Value<'a>, E> {
        Ok(Value::Text(Cow::Owned(text.to_owned())))
    }

    fn visit_seq<A: SeqAccess<'a>>(self, mut seq: A) -> Result<Value<'a>, A::Error> {
        let mut items = Vec::new();
        while items.len() < self.keep {
            match seq.next_element_seed(self.part(self.meant.item(items.len())))? {
                Some(item) => items.push(item),
                None => return Ok(Value::List { items, more: 0 }),
            }
        }
        let mut more = 0;
        while seq.next_element::<IgnoredAny>()?.is_some() {
            more += 1;
        }
        Ok(Value::List { items, more })
    }

    fn visit_map<A: MapAccess<'a>>(self, mut map: A) -> Result<Value<'a>, A::Error> {
        // A structure has a fixed number of fields; a map may have any length.
        let keep = match self.meant {
            Meant::Map(_) => self.keep,
            _ => usize::MAX,
        };
        let (mut fields, mut more) = (Vec::new(), 0);
        while let Some(name) = map.next_key::<String>()? {
            if fields.len() < keep {
                let value = map.next_value_seed(self.part(self.meant.member(&name)))?;
                fields.push((name.into(), value));
            } else {
                map.next_value::<IgnoredAny>()?;
                more += 1;
            }
        }
        Ok(match self.meant {
            Meant::Map(_) => {
                let entry = |(name, value)| (Value::Text(name), value);
                let entries = fields.into_iter().map(entry).collect();
                Value::Map { entries, more }
            }
            _ => Value::Struct(fields),
        })
    }
}
