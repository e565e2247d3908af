//! Encodes JSON from the command line as a message of a type.

use serde_json::Value as Json;
use sm2_proto::{
    schema::{Field, Scalar, Type, Variant},
    text::Counted,
};
use sm2_ros::value::float;

use super::{
    error::{EncodeError, step},
    shape::Shape,
};

/// The encoding of numbers and lengths.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Form {
    /// Numbers have a fixed width, and lists have no length.
    Plain,
    /// Numbers are varints, and each list starts with its length.
    Postcard,
    /// The JSON itself is the message, so the writer only checks the JSON.
    Json,
}

pub(super) fn encoded(form: Form, ty: &Type, given: &Json) -> Result<Vec<u8>, EncodeError> {
    let bytes = Vec::new();
    let mut writer = Writer { form, bytes };
    writer.value(ty, given)?;
    Ok(writer.bytes)
}

struct Writer {
    form: Form,
    bytes: Vec<u8>,
}

impl Writer {
    fn value(&mut self, ty: &Type, given: &Json) -> Result<(), EncodeError> {
        match ty {
            Type::Scalar(scalar) => self.scalar(*scalar, given),
            Type::Text => {
                self.text(
                    given
                        .as_str()
                        .ok_or_else(|| EncodeError::expected("text", given))?,
                );
                Ok(())
            }
            Type::Struct(fields) => self.fields(fields, given),
            Type::Enum(variants) => self.variant(variants, given),
            Type::Array { element, len } => match given.as_array() {
                Some(items) if items.len() as u64 == *len => self.items(element, items),
                _ => Err(wrong_count(*len, given)),
            },
            Type::List(element) | Type::Set(element) => match given.as_array() {
                Some(items) => {
                    self.len(items.len());
                    self.items(element, items)
                }
                None => Err(EncodeError::expected("an array", given)),
            },
            Type::Map { key, value } => self.map(key, value, given),
            Type::Option(_) if given.is_null() => {
                self.tag(0);
                Ok(())
            }
            Type::Option(value) => {
                self.tag(1);
                self.value(value, given)
            }
        }
    }

    fn items(&mut self, element: &Type, items: &[Json]) -> Result<(), EncodeError> {
        for (at, item) in items.iter().enumerate() {
            let written = self.value(element, item);
            written.map_err(|error| error.within(|| format!("[{at}]")))?;
        }
        Ok(())
    }

    fn fields(&mut self, fields: &[Field], given: &Json) -> Result<(), EncodeError> {
        match (Shape::of(fields), given) {
            (Shape::Unit, Json::Null) => Ok(()),
            (Shape::Unit, Json::Object(found)) if found.is_empty() => Ok(()),
            (Shape::Unit, Json::Array(found)) if found.is_empty() => Ok(()),
            (Shape::Unit, other) => Err(EncodeError::expected("null", other)),
            // Rust's `(T,)` is an array in JSON, and a structure with one nameless field is that field's value.
            (Shape::Single(ty), Json::Array(found)) if found.len() == 1 && !takes_array(ty) => {
                self.items(ty, found)
            }
            (Shape::Single(ty), given) => self.value(ty, given),
            (Shape::Tuple, Json::Array(found)) if found.len() == fields.len() => {
                for (at, (field, given)) in fields.iter().zip(found).enumerate() {
                    let written = self.value(field.ty(), given);
                    written.map_err(|error| error.within(|| format!("[{at}]")))?;
                }
                Ok(())
            }
            (Shape::Tuple, other) => Err(wrong_count(fields.len() as u64, other)),
            (Shape::Named, Json::Object(found)) => self.named(fields, found),
            (Shape::Named, other) => {
                let what = format!("an object with {}", names(fields.iter().map(Field::name)));
                Err(EncodeError::expected(&what, other))
            }
        }
    }

    fn named(
        &mut self,
        fields: &[Field],
        given: &serde_json::Map<String, Json>,
    ) -> Result<(), EncodeError> {
        let known = |name: &str| fields.iter().any(|field| field.name() == name);
        if let Some(name) = given.keys().find(|name| !known(name)) {
            let names = names(fields.iter().map(Field::name));
            let wrong = format!("there is no field {name:?}: it has {names}");
            return Err(EncodeError::new(wrong));
        }
        for field in fields {
            let within = |error: EncodeError| error.within(|| step(field.name()));
            match (given.get(field.name()), field.ty()) {
                (Some(given), ty) => self.value(ty, given).map_err(within)?,
                (None, Type::Option(_)) => self.tag(0),
                (None, _) => return Err(within(EncodeError::new("it is missing".to_owned()))),
            }
        }
        Ok(())
    }

    fn variant(&mut self, variants: &[Variant], given: &Json) -> Result<(), EncodeError> {
        let nothing = Json::Null;
        let (name, fields) = match given {
            Json::String(name) => (name, &nothing),
            Json::Object(found) if found.len() == 1 => match found.iter().next() {
                Some(only) => only,
                None => return Err(EncodeError::expected("a variant", given)),
            },
            other => {
                let what = "a variant: \"Name\", or {\"Name\": fields}";
                return Err(EncodeError::expected(what, other));
            }
        };
        let mut numbered = variants.iter().enumerate();
        let Some((number, variant)) = numbered.find(|(_, it)| it.name() == name) else {
            let names = names(variants.iter().map(Variant::name));
            let wrong = format!("there is no variant {name:?}: it has {names}");
            return Err(EncodeError::new(wrong));
        };
        if self.form == Form::Postcard {
            self.varint(number as u128);
        }
        let written = self.fields(variant.fields(), fields);
        written.map_err(|error| error.within(|| step(name)))
    }

    fn map(&mut self, key: &Type, value: &Type, given: &Json) -> Result<(), EncodeError> {
        match given {
            Json::Object(found) => {
                self.len(found.len());
                for (name, given) in found {
                    let within = |error: EncodeError| error.within(|| format!("[{name:?}]"));
                    self.value(key, &key_of(key, name)).map_err(within)?;
                    self.value(value, given).map_err(within)?;
                }
                Ok(())
            }
            // Maps whose keys JSON objects cannot have.
            Json::Array(pairs) if self.form != Form::Json => {
                self.len(pairs.len());
                for (at, pair) in pairs.iter().enumerate() {
                    let within = |error: EncodeError| error.within(|| format!("[{at}]"));
                    let Some([first, second]) = pair.as_array().map(Vec::as_slice) else {
                        return Err(within(EncodeError::expected("a key and a value", pair)));
                    };
                    self.value(key, first).map_err(within)?;
                    self.value(value, second).map_err(within)?;
                }
                Ok(())
            }
            other => Err(EncodeError::expected("an object", other)),
        }
    }

    fn scalar(&mut self, scalar: Scalar, given: &Json) -> Result<(), EncodeError> {
        match scalar {
            Scalar::U8 => self.unsigned(8, given),
            Scalar::U16 => self.unsigned(16, given),
            Scalar::U32 => self.unsigned(32, given),
            Scalar::U64 => self.unsigned(64, given),
            Scalar::U128 => self.unsigned(128, given),
            Scalar::I8 => self.signed(8, given),
            Scalar::I16 => self.signed(16, given),
            Scalar::I32 => self.signed(32, given),
            Scalar::I64 => self.signed(64, given),
            Scalar::I128 => self.signed(128, given),
            Scalar::F32 => {
                let number = self.float(given)?;
                if number.is_finite() && !(number as f32).is_finite() {
                    return Err(EncodeError::expected("a number of 32 bits", given));
                }
                self.put(&(number as f32).to_le_bytes());
                Ok(())
            }
            Scalar::F64 => {
                let number = self.float(given)?;
                self.put(&number.to_le_bytes());
                Ok(())
            }
            Scalar::Bool => match given {
                Json::Bool(value) => {
                    self.put(&[u8::from(*value)]);
                    Ok(())
                }
                other => Err(EncodeError::expected("true or false", other)),
            },
            Scalar::Char => {
                let mut chars = given.as_str().unwrap_or_default().chars();
                let (Some(c), None) = (chars.next(), chars.next()) else {
                    return Err(EncodeError::expected("a text of one character", given));
                };
                match self.form {
                    Form::Plain => self.put(&u32::from(c).to_le_bytes()),
                    Form::Postcard | Form::Json => self.text(c.encode_utf8(&mut [0; 4])),
                }
                Ok(())
            }
        }
    }

    fn unsigned(&mut self, bits: u32, given: &Json) -> Result<(), EncodeError> {
        let max = u128::MAX >> (128 - bits);
        let number = match given {
            Json::Number(number) => number.as_u128(),
            Json::String(digits) if self.takes_digits(bits) => digits.parse().ok(),
            _ => None,
        };
        let Some(number) = number.filter(|number| *number <= max) else {
            let what = format!("a whole number of 0 to {max}");
            return Err(EncodeError::expected(&what, given));
        };
        match self.form {
            Form::Postcard if bits > 8 => self.varint(number),
            _ => self.put(&number.to_le_bytes()[..bits as usize / 8]),
        }
        Ok(())
    }

    fn signed(&mut self, bits: u32, given: &Json) -> Result<(), EncodeError> {
        let max = i128::MAX >> (128 - bits);
        let number = match given {
            Json::Number(number) => number.as_i128(),
            Json::String(digits) if self.takes_digits(bits) => digits.parse().ok(),
            _ => None,
        };
        let Some(number) = number.filter(|number| (!max..=max).contains(number)) else {
            let what = format!("a whole number of {} to {max}", !max);
            return Err(EncodeError::expected(&what, given));
        };
        match self.form {
            // Zig-zag: 0, -1, 1, -2 are 0, 1, 2, 3.
            Form::Postcard if bits > 8 => {
                self.varint((number << 1 ^ number >> 127).cast_unsigned())
            }
            _ => self.put(&number.to_le_bytes()[..bits as usize / 8]),
        }
        Ok(())
    }

    /// In the JSON encoding, only a number stands for a number: other readers accept nothing else.
    fn takes_digits(&self, bits: u32) -> bool {
        bits == 128 && self.form != Form::Json
    }

    fn float(&self, given: &Json) -> Result<f64, EncodeError> {
        let number = match self.form {
            Form::Json => given.as_f64(),
            Form::Plain | Form::Postcard => float(given),
        };
        number.ok_or_else(|| EncodeError::expected("a number", given))
    }

    fn text(&mut self, text: &str) {
        self.len(text.len());
        self.put(text.as_bytes());
    }

    fn len(&mut self, len: usize) {
        if self.form == Form::Postcard {
            self.varint(len as u128);
        }
    }

    fn tag(&mut self, tag: u8) {
        self.put(&[tag]);
    }

    fn varint(&mut self, mut number: u128) {
        while number >= 0x80 {
            self.bytes.push(number as u8 | 0x80);
            number >>= 7;
        }
        self.bytes.push(number as u8);
    }

    fn put(&mut self, bytes: &[u8]) {
        if self.form != Form::Json {
            self.bytes.extend_from_slice(bytes);
        }
    }
}

fn wrong_count(len: u64, given: &Json) -> EncodeError {
    let values = Counted::new(len, "value");
    match given.as_array() {
        Some(items) => {
            let found = items.len();
            EncodeError::new(format!("expected {values}, found {found}"))
        }
        None => EncodeError::expected(&format!("an array of {values}"), given),
    }
}

/// Whether a value of this type is an array in JSON.
fn takes_array(ty: &Type) -> bool {
    match ty {
        Type::Array { .. } | Type::List(_) | Type::Set(_) | Type::Map { .. } => true,
        Type::Struct(fields) => match Shape::of(fields) {
            Shape::Tuple | Shape::Unit => true,
            Shape::Single(ty) => takes_array(ty),
            Shape::Named => false,
        },
        Type::Option(value) => takes_array(value),
        Type::Scalar(_) | Type::Text | Type::Enum(_) => false,
    }
}

/// The JSON value of an object's key. Keys are always texts in JSON.
fn key_of(ty: &Type, key: &str) -> Json {
    let text = || Json::String(key.to_owned());
    match ty {
        Type::Text | Type::Scalar(Scalar::Char | Scalar::U128 | Scalar::I128) => text(),
        _ => serde_json::from_str(key).unwrap_or_else(|_| text()),
    }
}

fn names<'a>(names: impl Iterator<Item = &'a str>) -> String {
    match names.collect::<Vec<_>>().as_slice() {
        [] => "none".to_owned(),
        names => names.join(", ").escape_debug().to_string(),
    }
}
