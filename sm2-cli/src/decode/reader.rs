//! Decodes plain and postcard messages of a type.

use sm2_proto::schema::{Field, Layout, Scalar, Type, Variant};
use sm2_ros::Value;

use super::{
    error::{DecodeError, Wrong, step},
    shape::Shape,
};

/// The average number of values that one byte may decode to. Nested structures need several. Without a limit,
/// a list of empty structures would decode to any number of values without a single byte.
const VALUES_PER_BYTE: usize = 16;
/// The number of values that a message without bytes may decode to.
const VALUES_OF_NOTHING: usize = 4_096;

/// The encoding of numbers and lengths.
#[derive(Clone, Copy)]
pub(super) enum Form {
    /// Numbers have a fixed width. The only list has this many elements, computed from the message's length.
    Plain { elements: u64 },
    /// Numbers are varints. A list starts with its length.
    Postcard,
}

pub(super) struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
    form: Form,
    /// The number of elements of a list that are kept.
    keep: usize,
    /// The number of values that may still be decoded.
    values: usize,
}

impl<'a> Reader<'a> {
    pub(super) const fn new(bytes: &'a [u8], form: Form, keep: usize) -> Self {
        Self {
            bytes,
            at: 0,
            form,
            keep,
            values: bytes
                .len()
                .saturating_mul(VALUES_PER_BYTE)
                .saturating_add(VALUES_OF_NOTHING),
        }
    }

    /// Decodes all bytes as one value.
    pub(super) fn whole(mut self, ty: &'a Type) -> Result<Value<'a>, DecodeError> {
        let value = self.value(ty)?;
        match self.bytes.len() - self.at {
            0 => Ok(value),
            rest => Err(self.wrong(Wrong::LeftOver(rest))),
        }
    }

    /// Decodes one value. The depth of the type limits the recursion.
    fn value(&mut self, ty: &'a Type) -> Result<Value<'a>, DecodeError> {
        self.values = match self.values.checked_sub(1) {
            Some(left) => left,
            None => return Err(self.wrong(Wrong::TooMany)),
        };
        match ty {
            Type::Scalar(scalar) => self.scalar(*scalar),
            Type::Text => Ok(Value::Text(self.text()?.into())),
            Type::Struct(fields) => self.fields(fields),
            Type::Enum(variants) => self.variant(variants),
            Type::Array { element, len } => self.list(element, *len),
            Type::List(element) | Type::Set(element) => {
                let len = self.len()?;
                self.list(element, len)
            }
            Type::Map { key, value } => self.map(key, value),
            Type::Option(value) => {
                let at = self.at;
                match self.byte()? {
                    0 => Ok(Value::Absent),
                    1 => self.value(value),
                    other => Err(DecodeError::new(at, Wrong::Option(other))),
                }
            }
        }
    }

    fn fields(&mut self, fields: &'a [Field]) -> Result<Value<'a>, DecodeError> {
        match Shape::of(fields) {
            Shape::Unit => Ok(Value::Unit),
            Shape::Single(ty) => self.value(ty),
            Shape::Tuple => {
                let mut items = Vec::new();
                for (at, field) in fields.iter().enumerate() {
                    items.push(self.part(field.ty(), || format!("[{at}]"))?);
                }
                Ok(Value::List { items, more: 0 })
            }
            Shape::Named => {
                let mut values = Vec::new();
                for field in fields {
                    let value = self.part(field.ty(), || step(field.name()))?;
                    values.push((field.name().into(), value));
                }
                Ok(Value::Struct(values))
            }
        }
    }

    fn variant(&mut self, variants: &'a [Variant]) -> Result<Value<'a>, DecodeError> {
        let at = self.at;
        let number = self.varint(32)? as u32;
        let Some(variant) = variants.get(number as usize) else {
            return Err(DecodeError::new(at, Wrong::Variant(number)));
        };
        let name = variant.name();
        let fields = self.fields(variant.fields());
        let fields = fields.map_err(|error| error.within(|| step(name)))?;
        Ok(Value::Variant(name, Box::new(fields)))
    }

    fn list(&mut self, element: &'a Type, len: u64) -> Result<Value<'a>, DecodeError> {
        let size = self.size_of(element);
        let mut items = Vec::new();
        let mut at = 0;
        while at < len {
            if items.len() >= self.keep
                && let Some(size) = size
            {
                self.pass(size.saturating_mul(len - at))?;
                break;
            }
            let item = self.part(element, || format!("[{at}]"))?;
            if items.len() < self.keep {
                items.push(item);
            }
            at += 1;
        }
        let more = len - items.len() as u64;
        Ok(Value::List { items, more })
    }

    /// The size of a type whose values all have this size and accept all bytes. Such elements can
    /// be skipped without decoding them.
    fn size_of(&self, ty: &Type) -> Option<u64> {
        match (self.form, ty) {
            (Form::Plain { .. }, ty) => Layout::size_of(ty).ok(),
            (Form::Postcard, Type::Scalar(scalar)) => match scalar {
                Scalar::U8 | Scalar::I8 | Scalar::F32 | Scalar::F64 => Some(scalar.size_bytes()),
                _ => None,
            },
            (Form::Postcard, Type::Struct(fields)) => {
                let mut sizes = fields.iter().map(|field| self.size_of(field.ty()));
                let size = sizes.try_fold(0_u64, |sum, size| sum.checked_add(size?))?;
                // The message's length does not limit the number of elements without bytes.
                (size > 0).then_some(size)
            }
            (Form::Postcard, _) => None,
        }
    }

    fn pass(&mut self, bytes: u64) -> Result<(), DecodeError> {
        self.take(usize::try_from(bytes).unwrap_or(usize::MAX))?;
        Ok(())
    }

    fn map(&mut self, key: &'a Type, value: &'a Type) -> Result<Value<'a>, DecodeError> {
        let len = self.len()?;
        let mut entries = Vec::new();
        for at in 0..len {
            let key = self.part(key, || format!("[{at}].key"))?;
            let value = self.part(value, || format!("[{at}].value"))?;
            if entries.len() < self.keep {
                entries.push((key, value));
            }
        }
        let more = len - entries.len() as u64;
        Ok(Value::Map { entries, more })
    }

    fn part(
        &mut self,
        ty: &'a Type,
        step: impl FnOnce() -> String,
    ) -> Result<Value<'a>, DecodeError> {
        self.value(ty).map_err(|error| error.within(step))
    }

    fn scalar(&mut self, scalar: Scalar) -> Result<Value<'a>, DecodeError> {
        let at = self.at;
        Ok(match scalar {
            Scalar::U8 => Value::Unsigned(self.byte()?.into()),
            Scalar::U16 => Value::Unsigned(self.unsigned(16)? as u64),
            Scalar::U32 => Value::Unsigned(self.unsigned(32)? as u64),
            Scalar::U64 => Value::Unsigned(self.unsigned(64)? as u64),
            Scalar::U128 => Value::Digits(self.unsigned(128)?.to_string()),
            Scalar::I8 => Value::Signed((self.byte()? as i8).into()),
            Scalar::I16 => Value::Signed(self.signed(16)? as i64),
            Scalar::I32 => Value::Signed(self.signed(32)? as i64),
            Scalar::I64 => Value::Signed(self.signed(64)? as i64),
            Scalar::I128 => Value::Digits(self.signed(128)?.to_string()),
            Scalar::F32 => Value::F32(f32::from_bits(self.fixed(4)? as u32)),
            Scalar::F64 => Value::F64(f64::from_bits(self.fixed(8)? as u64)),
            Scalar::Bool => match self.byte()? {
                0 => Value::Bool(false),
                1 => Value::Bool(true),
                other => return Err(DecodeError::new(at, Wrong::Bool(other))),
            },
            Scalar::Char => Value::Char(self.char()?),
        })
    }

    fn char(&mut self) -> Result<char, DecodeError> {
        let at = self.at;
        match self.form {
            Form::Plain { .. } => {
                let number = self.fixed(4)? as u32;
                char::from_u32(number).ok_or(DecodeError::new(at, Wrong::Char(number)))
            }
            Form::Postcard => {
                let mut chars = self.text()?.chars();
                match (chars.next(), chars.next()) {
                    (Some(c), None) => Ok(c),
                    _ => Err(DecodeError::new(at, Wrong::Chars)),
                }
            }
        }
    }

    fn text(&mut self) -> Result<&'a str, DecodeError> {
        let len = self.len()?;
        let at = self.at;
        let bytes = self.take(usize::try_from(len).unwrap_or(usize::MAX))?;
        str::from_utf8(bytes)
            .map_err(|error| DecodeError::new(at + error.valid_up_to(), Wrong::Utf8))
    }

    /// Reads the length of a list or text.
    fn len(&mut self) -> Result<u64, DecodeError> {
        match self.form {
            Form::Plain { elements } => Ok(elements),
            Form::Postcard => Ok(self.varint(64)? as u64),
        }
    }

    fn unsigned(&mut self, bits: u32) -> Result<u128, DecodeError> {
        match self.form {
            Form::Plain { .. } => self.fixed(bits as usize / 8),
            Form::Postcard => self.varint(bits),
        }
    }

    fn signed(&mut self, bits: u32) -> Result<i128, DecodeError> {
        match self.form {
            Form::Plain { .. } => {
                let unused = 128 - bits;
                Ok((self.fixed(bits as usize / 8)? << unused).cast_signed() >> unused)
            }
            // Zig-zag: 0, -1, 1, -2 are 0, 1, 2, 3.
            Form::Postcard => {
                let number = self.varint(bits)?;
                Ok((number >> 1).cast_signed() ^ -(number & 1).cast_signed())
            }
        }
    }

    fn varint(&mut self, bits: u32) -> Result<u128, DecodeError> {
        let at = self.at;
        let mut number = 0;
        for shift in (0..bits).step_by(7) {
            let byte = self.byte()?;
            let group = u128::from(byte & 0x7f);
            if bits - shift < 7 && group >> (bits - shift) != 0 {
                break;
            }
            number |= group << shift;
            if byte < 0x80 {
                return Ok(number);
            }
        }
        Err(DecodeError::new(at, Wrong::Number))
    }

    fn fixed(&mut self, len: usize) -> Result<u128, DecodeError> {
        let bytes = self.take(len)?.iter().rev();
        Ok(bytes.fold(0, |number, byte| number << 8 | u128::from(*byte)))
    }

    fn byte(&mut self) -> Result<u8, DecodeError> {
        Ok(self.take(1)?[0])
    }

    fn take(&mut self, len: usize) -> Result<&'a [u8], DecodeError> {
        let rest = &self.bytes[self.at..];
        let bytes = rest.get(..len).ok_or(self.wrong(Wrong::Short))?;
        self.at += len;
        Ok(bytes)
    }

    const fn wrong(&self, wrong: Wrong) -> DecodeError {
        DecodeError::new(self.at, wrong)
    }
}
