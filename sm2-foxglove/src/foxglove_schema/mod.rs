//! The schemas of Foxglove that its panels know, such as `foxglove.LaserScan`.
//!
//! A structure of the domain is a message of such a schema if it has the same fields: the same names, and types of the
//! same JSON. Their order does not matter.
//!
//! | kind of a field | types of the domain | JSON of Foxglove |
//! | --- | --- | --- |
//! | text | text | string |
//! | number | floating-point number | number |
//! | whole number, enumeration | whole number of up to 64 bits | integer |
//! | time, duration | structure of the whole numbers `sec` and `nsec` | object |
//! | bytes | list or array of `u8` | string in base64 |
//! | structure | structure with the same fields | object |
//! | list | list, or array of the right length | array |
//! | optional field | its type, an optional value of it, or no field | the value, or no field |
//!
//! `CompressedImage` and `CompressedVideo` have the same fields, so the name of the type decides between them.

mod kind;
mod table;

use std::convert::Infallible;

use base64::{Engine as _, engine::general_purpose::STANDARD as BASE64};
use serde_json::{Value, json};
use sm2_proto::{
    Name,
    schema::{Scalar, Type},
};

pub(crate) use self::kind::FoxgloveSchema;
use self::kind::{Field, Kind};
use self::table::SCHEMAS;

impl FoxgloveSchema {
    /// The schema whose fields are those of a type. `None` if there is none, or if several are, and the last segment
    /// of the type's name is not the name of one of them.
    pub(crate) fn of(name: &Name, ty: &Type) -> Option<&'static Self> {
        let fits: Vec<_> = SCHEMAS.iter().filter(|it| it.root.fits(ty)).collect();
        let own = name.as_str().rsplit('/').next();
        let same = (fits.iter()).find(|it| it.name.strip_prefix("foxglove.") == own);
        match (same, &fits[..]) {
            (Some(same), _) => Some(same),
            (None, [only]) => Some(only),
            (None, _) => None,
        }
    }

    /// The schema as JSON Schema.
    pub(crate) fn json_schema(&self) -> Value {
        self.root.json_schema()
    }

    /// Turns the JSON of a message of the domain into that of Foxglove.
    pub(crate) fn to_viewer(&self, message: &mut Value) {
        let Ok(()) = self.root.convert(message, &|kind, value| {
            match (kind, &mut *value) {
                (Kind::Bytes, Value::Array(bytes)) => {
                    let bytes = bytes.iter().filter_map(|it| it.as_u64()?.try_into().ok());
                    *value = BASE64.encode(bytes.collect::<Vec<u8>>()).into();
                }
                // An optional field without a value is not a field.
                (Kind::Object(_), Value::Object(values)) => values.retain(|_, it| !it.is_null()),
                _ => {}
            }
            Ok::<_, Infallible>(())
        });
    }

    /// Turns the JSON of Foxglove into that of a message of the domain.
    ///
    /// # Errors
    ///
    /// Bytes are not in base64.
    pub(crate) fn to_domain(&self, message: &mut Value) -> Result<(), WrongBase64> {
        self.root.convert(message, &|kind, value| {
            if let (Kind::Bytes, Value::String(text)) = (kind, &*value) {
                *value = BASE64.decode(text)?.into();
            }
            Ok(())
        })
    }
}

/// A field of bytes is not in base64.
pub(crate) type WrongBase64 = base64::DecodeError;

impl Kind {
    fn fits(&self, ty: &Type) -> bool {
        match (self, ty) {
            (Self::Text, Type::Text) => true,
            (Self::Number, Type::Scalar(it)) => matches!(it, Scalar::F32 | Scalar::F64),
            (Self::Boolean, Type::Scalar(it)) => *it == Scalar::Bool,
            (Self::Integer, Type::Scalar(it)) => is_integer(*it),
            (Self::Bytes, Type::List(element) | Type::Array { element, .. }) => {
                **element == Type::Scalar(Scalar::U8)
            }
            (Self::List { element, .. }, Type::List(its)) => element.fits(its),
            (
                Self::List { element, len },
                Type::Array {
                    element: its,
                    len: n,
                },
            ) => element.fits(its) && len.is_none_or(|it| it == *n),
            (Self::Object(fields), Type::Struct(its)) => {
                let field = |name: &str| fields.iter().find(|it| it.name == name);
                let has = |name: &str| its.iter().any(|it| it.name() == name);
                its.iter()
                    .all(|it| field(it.name()).is_some_and(|field| field.fits(it.ty())))
                    && fields.iter().all(|it| it.is_optional || has(it.name))
            }
            _ => false,
        }
    }

    fn json_schema(&self) -> Value {
        match self {
            Self::Text => json!({ "type": "string" }),
            Self::Number => json!({ "type": "number" }),
            Self::Integer => json!({ "type": "integer" }),
            Self::Boolean => json!({ "type": "boolean" }),
            Self::Bytes => json!({ "type": "string", "contentEncoding": "base64" }),
            Self::Object(fields) => {
                let property = |it: &Field| (it.name.to_owned(), it.kind.json_schema());
                let properties: serde_json::Map<_, _> = fields.iter().map(property).collect();
                json!({ "type": "object", "properties": properties })
            }
            Self::List { element, .. } => {
                json!({ "type": "array", "items": element.json_schema() })
            }
        }
    }

    /// Converts a value, then those inside it.
    fn convert<E>(
        &self,
        value: &mut Value,
        each: &impl Fn(&Self, &mut Value) -> Result<(), E>,
    ) -> Result<(), E> {
        each(self, value)?;
        match (self, value) {
            (Self::Object(fields), Value::Object(values)) => {
                for field in *fields {
                    if let Some(value) = values.get_mut(field.name) {
                        field.kind.convert(value, each)?;
                    }
                }
            }
            (Self::List { element, .. }, Value::Array(values)) => {
                for value in values {
                    element.convert(value, each)?;
                }
            }
            _ => {}
        }
        Ok(())
    }
}

impl Field {
    fn fits(&self, ty: &Type) -> bool {
        match ty {
            Type::Option(value) if self.is_optional => self.kind.fits(value),
            ty => self.kind.fits(ty),
        }
    }
}

const fn is_integer(scalar: Scalar) -> bool {
    match scalar {
        Scalar::U8 | Scalar::U16 | Scalar::U32 | Scalar::U64 => true,
        Scalar::I8 | Scalar::I16 | Scalar::I32 | Scalar::I64 => true,
        Scalar::U128 | Scalar::I128 => false,
        Scalar::F32 | Scalar::F64 | Scalar::Bool | Scalar::Char => false,
    }
}

#[cfg(test)]
mod tests;
