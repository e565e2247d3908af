//! Encodes JSON as a message, by the definition of its type.

use serde_json::Value as Json;
use sm2_ros_idl::{Base, Field, FieldType, Message, Primitive, Set, Shape, TypeName};

use crate::cdr::Writer;
use crate::value::{float, found};
use crate::{EncodeError, FieldPath};

/// Encodes a JSON object as a message of the type `name`. Fields that the object lacks have the default value
/// of the definition, or else zero, the empty text or the empty sequence. The texts `NaN`, `inf` and `-inf` are
/// floating-point numbers, too.
///
/// # Errors
///
/// [`EncodeError`] with the path to the value that does not fit its type, or with the type that `set` lacks.
pub fn encode(set: &Set, name: &TypeName, value: &Json) -> Result<Vec<u8>, EncodeError> {
    // No type contains itself, and the nesting has a limit, so the recursion below has one.
    set.closure(name)?;
    let mut encoder = Encoder {
        set,
        writer: Writer::new(Vec::new()),
        missing: 0,
    };
    encoder.message(set.get(name)?, Some(value))?;
    Ok(encoder.writer.into_sink())
}

/// The longest message that is written, in bytes. Definitions can ask for more by themselves, with large
/// arrays.
const MAX_BYTES: usize = 1 << 26;
/// The most values that are written without JSON for them; a default value counts by its length as well. Definitions
/// can ask for more than the bytes of the message show, with arrays of arrays and long default values.
const MISSING_MAX: usize = 1 << 22;

struct Encoder<'s> {
    set: &'s Set,
    writer: Writer<Vec<u8>>,
    /// The number of values so far that the JSON lacks.
    missing: usize,
}

impl Encoder<'_> {
    fn message(&mut self, message: &Message, given: Option<&Json>) -> Result<(), EncodeError> {
        let object = match given {
            None => None,
            Some(Json::Object(object)) => Some(object),
            Some(other) => return Err(wrong("an object with the fields", other)),
        };
        let mut names = object.into_iter().flat_map(|it| it.keys());
        if let Some(field) = names.find(|it| message.fields.iter().all(|f| *f.name != ***it)) {
            return Err(EncodeError::Field {
                path: FieldPath::MESSAGE,
                ty: message.name.to_string(),
                field: field.clone(),
            });
        }
        if message.fields.is_empty() {
            // IDL has no structure without fields: ROS 2 sends a byte.
            self.room(1)?;
            self.writer.number(0_u8);
        }
        for field in &message.fields {
            let given = object.and_then(|it| it.get(&*field.name));
            let written = match (given, field.default.as_deref()) {
                (None, Some(text)) => self.default(field, text),
                (given, _) => self.field(&field.ty, given),
            };
            written.map_err(|error| error.within(&field.name))?;
        }
        Ok(())
    }

    fn default(&mut self, field: &Field, text: &str) -> Result<(), EncodeError> {
        self.spend(text.len())?;
        self.field(&field.ty, Some(&default_of(field, text)?))
    }

    fn field(&mut self, ty: &FieldType, given: Option<&Json>) -> Result<(), EncodeError> {
        let items = match (ty.shape, given, &ty.base) {
            (Shape::One, ..) => return self.value(&ty.base, given),
            (Shape::Array(len), None, Base::Primitive(primitive)) => {
                let (len, size) = (len as usize, primitive.size_bytes());
                self.room(len.saturating_mul(size).saturating_add(size))?;
                self.writer.zeros(len, size);
                return Ok(());
            }
            (_, None, _) => None,
            (_, Some(Json::Array(items)), _) => Some(items),
            (_, Some(other), _) => return Err(wrong("an array", other)),
        };
        let count = items.map(Vec::len);
        let len = match ty.shape {
            Shape::Array(len) => {
                let len = len as usize;
                if count.is_some_and(|count| count != len) {
                    return Err(wrong_len(&format!("{len} elements"), count));
                }
                // Every element has at least one byte.
                self.room(len)?;
                len
            }
            Shape::Sequence(max) => {
                let len = count.unwrap_or(0);
                if let Some(max) = max.filter(|max| len > *max as usize) {
                    return Err(wrong_len(&format!("at most {max} elements"), count));
                }
                self.room(8)?;
                self.writer.len(len, None)?;
                len
            }
            Shape::One => 1,
        };
        for at in 0..len {
            let item = items.and_then(|it| it.get(at));
            let written = self.value(&ty.base, item);
            written.map_err(|error| error.within(&format!("[{at}]")))?;
        }
        Ok(())
    }

    fn value(&mut self, base: &Base, given: Option<&Json>) -> Result<(), EncodeError> {
        if given.is_none() {
            self.spend(1)?;
        }
        match base {
            Base::Primitive(primitive) => {
                self.room(2 * primitive.size_bytes())?;
                self.primitive(*primitive, given)
            }
            Base::String { max_bytes } => {
                let text = text(given, *max_bytes, str::len)?;
                self.room(text.len() + 9)?;
                self.writer.text(text, None)
            }
            Base::WString { max_units } => {
                let text = text(given, *max_units, |it| it.encode_utf16().count())?;
                self.room(2 * text.len() + 9)?;
                self.writer.wide_text(text, None)
            }
            Base::Message(name) => {
                let set = self.set;
                self.message(set.get(name)?, given)
            }
        }
    }

    fn primitive(&mut self, primitive: Primitive, given: Option<&Json>) -> Result<(), EncodeError> {
        macro_rules! write {
            ($type:ty, $take:expr) => {{
                let number: $type = match given {
                    None => Default::default(),
                    Some(given) => match $take(given) {
                        Some(number) => number,
                        None => return Err(wrong(primitive.name(), given)),
                    },
                };
                self.writer.number(number);
            }};
        }
        macro_rules! integer {
            ($type:ty, $as:ident) => {
                write!($type, |it: &Json| it.$as()?.try_into().ok())
            };
        }
        match primitive {
            Primitive::Bool => write!(u8, |it: &Json| it.as_bool().map(u8::from)),
            Primitive::Byte | Primitive::Char | Primitive::Uint8 => integer!(u8, as_u64),
            Primitive::Uint16 => integer!(u16, as_u64),
            Primitive::Uint32 => integer!(u32, as_u64),
            Primitive::Uint64 => integer!(u64, as_u64),
            Primitive::Int8 => integer!(i8, as_i64),
            Primitive::Int16 => integer!(i16, as_i64),
            Primitive::Int32 => integer!(i32, as_i64),
            Primitive::Int64 => integer!(i64, as_i64),
            // The nearest number of 32 bits is meant.
            Primitive::Float32 => write!(f32, |it: &Json| float(it).map(|it| it as f32)),
            Primitive::Float64 => write!(f64, float),
        }
        Ok(())
    }

    fn room(&self, bytes: usize) -> Result<(), EncodeError> {
        if bytes <= MAX_BYTES.saturating_sub(self.writer.len_bytes()) {
            return Ok(());
        }
        Err(EncodeError::TooLong {
            path: FieldPath::MESSAGE,
            max: MAX_BYTES,
        })
    }

    fn spend(&mut self, values: usize) -> Result<(), EncodeError> {
        self.missing += values;
        if self.missing <= MISSING_MAX {
            return Ok(());
        }
        Err(EncodeError::Missing {
            path: FieldPath::MESSAGE,
            max: MISSING_MAX,
        })
    }
}

fn text(
    given: Option<&Json>,
    max: Option<u32>,
    len: impl Fn(&str) -> usize,
) -> Result<&str, EncodeError> {
    let text = match given {
        None => "",
        Some(Json::String(text)) => text,
        Some(other) => return Err(wrong("a text", other)),
    };
    match max {
        Some(max) if len(text) > max as usize => Err(wrong_len(
            &format!("a text of at most {max}"),
            Some(len(text)),
        )),
        _ => Ok(text),
    }
}

/// The default value of a field as JSON.
fn default_of(field: &Field, text: &str) -> Result<Json, EncodeError> {
    let is_text = matches!(field.ty.base, Base::String { .. } | Base::WString { .. });
    if is_text && field.ty.shape == Shape::One {
        return Ok(Json::from(unquoted(text)));
    }
    let json = serde_json::from_str(text)
        .or_else(|_| serde_json::from_str(&text.to_ascii_lowercase()))
        .or_else(|_| serde_json::from_str(&text.replace('\'', "\"")));
    json.map_err(|_| wrong("a default value", &Json::from(text)))
}

fn unquoted(text: &str) -> &str {
    let inner = |quote| text.strip_prefix(quote)?.strip_suffix(quote);
    inner('"').or_else(|| inner('\'')).unwrap_or(text)
}

fn wrong(expected: &str, given: &Json) -> EncodeError {
    EncodeError::Value {
        path: FieldPath::MESSAGE,
        expected: expected.to_owned(),
        found: found(given),
    }
}

fn wrong_len(expected: &str, found: Option<usize>) -> EncodeError {
    EncodeError::Value {
        path: FieldPath::MESSAGE,
        expected: expected.to_owned(),
        found: found.unwrap_or(0).to_string(),
    }
}
