//! Decodes a message by the definition of its type.

use sm2_ros_idl::{Base, FieldType, Message, Primitive, Set, Shape, TypeName};

use crate::cdr::Reader;
use crate::{DecodeError, Fault, Value};

/// Decodes a message of the type `name`. The first `keep` elements of each array and sequence are kept, and the
/// others are checked and counted. The value borrows its texts from `bytes`, and the names of its fields from `set`.
///
/// # Errors
///
/// [`DecodeError`] with the path to the field whose bytes are wrong, or with the type that `set` lacks.
/// [`Fault::Values`] if more than 2^22 values would be kept.
pub fn decode<'a>(
    set: &'a Set,
    name: &TypeName,
    bytes: &'a [u8],
    keep: usize,
) -> Result<Value<'a>, DecodeError> {
    // No type contains itself, and the nesting has a limit, so the recursion below has one.
    set.closure(name)?;
    let mut decoder = Decoder {
        set,
        reader: Reader::new(bytes)?,
        keep,
        values: 0,
    };
    let value = decoder.message(set.get(name)?)?;
    decoder.reader.end()?;
    Ok(value)
}

/// The most values that are kept. Definitions can nest types 64 deep around a single byte, so the length of the
/// message alone does not limit the memory enough.
const VALUES_MAX: usize = 1 << 22;

struct Decoder<'a> {
    set: &'a Set,
    reader: Reader<&'a [u8]>,
    keep: usize,
    /// The number of values that are kept so far, and of those that are being decoded.
    values: usize,
}

impl<'a> Decoder<'a> {
    fn message(&mut self, message: &'a Message) -> Result<Value<'a>, DecodeError> {
        if message.fields.is_empty() {
            // IDL has no structure without fields: ROS 2 sends a byte.
            self.reader.skip(1)?;
        }
        let mut fields = Vec::with_capacity(message.fields.len());
        for field in &message.fields {
            let value = self.field(&field.ty);
            let value = value.map_err(|error| error.within(&field.name))?;
            fields.push((field.name.as_ref().into(), value));
        }
        Ok(Value::Struct(fields))
    }

    fn field(&mut self, ty: &'a FieldType) -> Result<Value<'a>, DecodeError> {
        let len = match ty.shape {
            Shape::One => return self.value(&ty.base),
            Shape::Array(len) => len,
            Shape::Sequence(max) => self.reader.len(max)?,
        };
        // Every element has at least one byte, so a hostile length ends here.
        let len = len as usize;
        if len > self.reader.remaining() {
            return Err(self.reader.wrong(Fault::Short));
        }
        let mut items = Vec::new();
        for at in 0..len {
            if at >= self.keep
                && let Base::Primitive(primitive) = ty.base
                && primitive != Primitive::Bool
            {
                // Each element is as long as its alignment, and the first one is aligned.
                self.reader.align(primitive.size_bytes())?;
                let rest = (len - at).saturating_mul(primitive.size_bytes());
                self.reader.skip(rest)?;
                break;
            }
            let before = self.values;
            let item = self.value(&ty.base);
            let item = item.map_err(|error| error.within(&format!("[{at}]")))?;
            if at < self.keep {
                items.push(item);
            } else {
                self.values = before;
            }
        }
        let more = (len - items.len()) as u64;
        Ok(Value::List { items, more })
    }

    fn value(&mut self, base: &'a Base) -> Result<Value<'a>, DecodeError> {
        self.values += 1;
        if self.values > VALUES_MAX {
            return Err(self.reader.wrong(Fault::Values));
        }
        let reader = &mut self.reader;
        Ok(match base {
            Base::Primitive(primitive) => reader.primitive(*primitive)?,
            Base::String { max_bytes } => Value::Text(reader.text(*max_bytes)?.into()),
            Base::WString { max_units } => Value::Text(reader.wide_string(*max_units)?.into()),
            Base::Message(name) => {
                let message = self.set.get(name)?;
                self.message(message)?
            }
        })
    }
}
