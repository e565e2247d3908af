//! Single values of a message, read by the definition of its type.
//!
//! A program that was not built with a type, such as one in Python, reads some fields of a message and skips the
//! others. It remembers where a value ends, because the next one begins there.

use sm2_ros_idl::{Base, FieldType, Message, Primitive, Set, Shape, TypeName};

use crate::cdr::{HEADER_BYTES, Reader, Source};
use crate::{DecodeError, Fault, Value};

/// The place of the first field of a message, in bytes.
pub const START: usize = HEADER_BYTES;

/// The most elements of one list of [`Part`]s. Lists of numbers have no limit.
const PARTS_MAX: usize = 1 << 22;

/// The value of a field, whose numbers and messages stay where they are.
#[derive(Clone, Debug, PartialEq)]
pub enum Part<'s> {
    /// A boolean, a number, or the copy of a text.
    Value(Value<'static>),
    /// An array or a sequence of numbers or booleans. Its bytes are not checked: a boolean may have any value.
    Numbers {
        /// The type of one number.
        primitive: Primitive,
        /// How many numbers there are.
        len: usize,
        /// The place of the first one, in bytes.
        at: usize,
        /// Their byte order.
        big_endian: bool,
    },
    /// An array or a sequence of texts or messages.
    List(Vec<Self>),
    /// A message.
    Message {
        /// Its type.
        name: &'s TypeName,
        /// The place of its first field, in bytes.
        at: usize,
    },
}

/// Reads the value of the type `ty` at the byte `at` of a message. Returns the value, and the place of the next one.
///
/// The caller has called [`Set::closure`] for the type of the message, so the types have no cycles.
///
/// # Errors
///
/// [`DecodeError`]; its path begins inside the value. [`Fault::Values`] if a list has more than 2^22 texts or messages.
pub fn read<'s>(
    set: &'s Set,
    ty: &'s FieldType,
    source: impl Source,
    at: usize,
) -> Result<(Part<'s>, usize), DecodeError> {
    let mut places = Places::new(set, source, at)?;
    let part = places.read(ty)?;
    Ok((part, places.reader.place()))
}

/// Skips the value of the type `ty` at the byte `at` of a message. Returns the place of the next one.
///
/// # Errors
///
/// As [`read`].
pub fn skip(
    set: &Set,
    ty: &FieldType,
    source: impl Source,
    at: usize,
) -> Result<usize, DecodeError> {
    let mut places = Places::new(set, source, at)?;
    places.skip(ty)?;
    Ok(places.reader.place())
}

struct Places<'s, S> {
    set: &'s Set,
    reader: Reader<S>,
}

impl<'s, S: Source> Places<'s, S> {
    fn new(set: &'s Set, source: S, at: usize) -> Result<Self, DecodeError> {
        let mut reader = Reader::new(source)?;
        reader.skip(at.saturating_sub(START))?;
        Ok(Self { set, reader })
    }

    fn read(&mut self, ty: &'s FieldType) -> Result<Part<'s>, DecodeError> {
        let Some(len) = self.len(ty)? else {
            return self.read_one(&ty.base);
        };
        if let Base::Primitive(primitive) = ty.base {
            let at = self.skip_numbers(primitive, len)?;
            return Ok(Part::Numbers {
                primitive,
                len,
                at,
                big_endian: self.reader.is_big_endian(),
            });
        }
        if len > PARTS_MAX {
            return Err(self.reader.wrong(Fault::Values));
        }
        let mut parts = Vec::new();
        for at in 0..len {
            parts.push(within(at, self.read_one(&ty.base))?);
        }
        Ok(Part::List(parts))
    }

    fn skip(&mut self, ty: &FieldType) -> Result<(), DecodeError> {
        match (self.len(ty)?, &ty.base) {
            (None, base) => self.skip_one(base),
            (Some(len), Base::Primitive(primitive)) => self.skip_numbers(*primitive, len).map(drop),
            (Some(len), base) => (0..len).try_for_each(|at| within(at, self.skip_one(base))),
        }
    }

    /// The number of elements of an array or a sequence; `None` for a single value.
    fn len(&mut self, ty: &FieldType) -> Result<Option<usize>, DecodeError> {
        let len = match ty.shape {
            Shape::One => return Ok(None),
            Shape::Array(len) => len,
            Shape::Sequence(max) => self.reader.len(max)?,
        };
        // Every element has at least one byte, so a hostile length ends here.
        let len = len as usize;
        if len > self.reader.remaining() {
            return Err(self.reader.wrong(Fault::Short));
        }
        Ok(Some(len))
    }

    /// Returns the place of the first number.
    fn skip_numbers(&mut self, primitive: Primitive, len: usize) -> Result<usize, DecodeError> {
        let size = primitive.size_bytes();
        if len > 0 {
            self.reader.align(size)?;
        }
        self.reader.skip(len.saturating_mul(size))
    }

    fn read_one(&mut self, base: &'s Base) -> Result<Part<'s>, DecodeError> {
        Ok(Part::Value(match base {
            Base::Primitive(primitive) => self.reader.primitive(*primitive)?,
            Base::String { max_bytes } => Value::Text(self.reader.string(*max_bytes)?.into()),
            Base::WString { max_units } => Value::Text(self.reader.wide_string(*max_units)?.into()),
            Base::Message(name) => {
                let at = self.reader.place();
                self.skip_one(base)?;
                return Ok(Part::Message { name, at });
            }
        }))
    }

    fn skip_one(&mut self, base: &Base) -> Result<(), DecodeError> {
        match base {
            Base::Primitive(primitive) => self.skip_numbers(*primitive, 1).map(drop),
            Base::String { max_bytes } => self.reader.text_place(*max_bytes).map(drop),
            Base::WString { max_units } => {
                let len = self.reader.len(*max_units)? as usize;
                self.skip_numbers(Primitive::Uint16, len).map(drop)
            }
            Base::Message(name) => self.skip_message(self.set.get(name)?),
        }
    }

    fn skip_message(&mut self, message: &Message) -> Result<(), DecodeError> {
        if message.fields.is_empty() {
            // IDL has no structure without fields: ROS 2 sends a byte.
            return self.reader.skip(1).map(drop);
        }
        message.fields.iter().try_for_each(|field| {
            let skipped = self.skip(&field.ty);
            skipped.map_err(|error| error.within(&field.name))
        })
    }
}

fn within<T>(at: usize, result: Result<T, DecodeError>) -> Result<T, DecodeError> {
    result.map_err(|error| error.within(&format!("[{at}]")))
}
