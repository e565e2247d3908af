//! Reads the bytes of CDR, one value after the other.

use sm2_ros_idl::Primitive;
use zerocopy::IntoBytes;

use super::{HEADER_BYTES, Number, Numbers, Source};
use crate::{DecodeError, Fault, Value};

/// A message, and the place of the next value.
///
/// Every method returns a [`DecodeError`] if the bytes at this place are not the value. Lengths are compared with the
/// bytes that remain before memory is allocated.
#[derive(Debug)]
pub struct Reader<S> {
    source: S,
    at: usize,
    len: usize,
    big_endian: bool,
}

impl<S: Source> Reader<S> {
    /// Reads the header.
    ///
    /// # Errors
    ///
    /// [`Fault::Header`].
    pub fn new(source: S) -> Result<Self, DecodeError> {
        let mut header = [0; HEADER_BYTES];
        let is_long_enough = source.copy_to(0, &mut header);
        let big_endian = match header {
            [0, 0, ..] if is_long_enough => true,
            [0, 1, ..] if is_long_enough => false,
            _ => return Err(DecodeError::new(0, Fault::Header)),
        };
        Ok(Self {
            at: HEADER_BYTES,
            len: source.len(),
            source,
            big_endian,
        })
    }

    /// Checks that the message ends here. ROS 2 may fill the last four bytes.
    ///
    /// # Errors
    ///
    /// [`Fault::LeftOver`].
    pub const fn end(&self) -> Result<(), DecodeError> {
        match self.remaining() {
            0..4 => Ok(()),
            rest => Err(self.wrong(Fault::LeftOver(rest))),
        }
    }

    pub(crate) const fn remaining(&self) -> usize {
        self.len - self.at
    }

    /// The place of the next value, in bytes.
    pub(crate) const fn place(&self) -> usize {
        self.at
    }

    pub(crate) const fn is_big_endian(&self) -> bool {
        self.big_endian
    }

    /// Skips to the next multiple of `size`, a power of two, counted from the end of the header.
    pub(crate) fn align(&mut self, size: usize) -> Result<(), DecodeError> {
        let offset = self.at - HEADER_BYTES;
        let skip = offset.next_multiple_of(size) - offset;
        self.skip(skip).map(drop)
    }

    /// Skips bytes. Returns the place of the first one.
    pub(crate) fn skip(&mut self, len: usize) -> Result<usize, DecodeError> {
        if len > self.remaining() {
            return Err(self.wrong(Fault::Short));
        }
        let at = self.at;
        self.at += len;
        Ok(at)
    }

    /// Takes an aligned number.
    ///
    /// # Errors
    ///
    /// [`Fault::Short`].
    #[inline]
    pub fn number<T: Number>(&mut self) -> Result<T, DecodeError> {
        self.align(size_of::<T>())?;
        let mut number = T::default();
        if !self.source.copy_to(self.at, number.as_mut_bytes()) {
            return Err(self.wrong(Fault::Short));
        }
        self.at += size_of::<T>();
        Ok(number.in_order(self.big_endian))
    }

    /// Takes the length of a text or sequence.
    pub(crate) fn len(&mut self, max: Option<u32>) -> Result<u32, DecodeError> {
        let len = self.number()?;
        self.check(len, max)?;
        Ok(len)
    }

    fn check(&self, len: u32, max: Option<u32>) -> Result<(), DecodeError> {
        match max {
            Some(max) if len > max => Err(self.wrong(Fault::Limit { len, max })),
            _ => Ok(()),
        }
    }

    /// Takes a boolean.
    ///
    /// # Errors
    ///
    /// [`Fault::Short`], [`Fault::Bool`].
    pub fn bool(&mut self) -> Result<bool, DecodeError> {
        match self.number::<u8>()? {
            0 => Ok(false),
            1 => Ok(true),
            other => Err(self.wrong(Fault::Bool(other))),
        }
    }

    /// Takes a boolean or a number.
    pub(crate) fn primitive(
        &mut self,
        primitive: Primitive,
    ) -> Result<Value<'static>, DecodeError> {
        Ok(match primitive {
            Primitive::Bool => Value::Bool(self.bool()?),
            Primitive::Byte | Primitive::Char | Primitive::Uint8 => {
                Value::Unsigned(self.number::<u8>()?.into())
            }
            Primitive::Uint16 => Value::Unsigned(self.number::<u16>()?.into()),
            Primitive::Uint32 => Value::Unsigned(self.number::<u32>()?.into()),
            Primitive::Uint64 => Value::Unsigned(self.number()?),
            Primitive::Int8 => Value::Signed(self.number::<i8>()?.into()),
            Primitive::Int16 => Value::Signed(self.number::<i16>()?.into()),
            Primitive::Int32 => Value::Signed(self.number::<i32>()?.into()),
            Primitive::Int64 => Value::Signed(self.number()?),
            Primitive::Float32 => Value::F32(self.number()?),
            Primitive::Float64 => Value::F64(self.number()?),
        })
    }

    /// Takes the length of a text in UTF-8, and skips the text. Returns its place.
    pub(crate) fn text_place(
        &mut self,
        max_bytes: Option<u32>,
    ) -> Result<(usize, usize), DecodeError> {
        let len = self.len(None)?;
        self.check(len.saturating_sub(1), max_bytes)?;
        let len = len as usize;
        Ok((self.skip(len)?, len))
    }

    /// Takes a copy of a text in UTF-8. Some programs write an empty text with length 0, without the byte 0.
    ///
    /// # Errors
    ///
    /// [`Fault::Short`], [`Fault::Limit`], [`Fault::Unterminated`], [`Fault::Unicode`].
    pub fn string(&mut self, max_bytes: Option<u32>) -> Result<String, DecodeError> {
        let (at, len) = self.text_place(max_bytes)?;
        let text = self.source.to_vec(at, len);
        // Checked in the copy: the source may change.
        let mut text = text.ok_or_else(|| self.wrong(Fault::Short))?;
        if text.pop().is_some_and(|last| last != 0) {
            return Err(self.wrong(Fault::Unterminated));
        }
        String::from_utf8(text).map_err(|_| self.wrong(Fault::Unicode))
    }

    /// Takes a text in UTF-16, whose length counts units of 16 bits.
    ///
    /// # Errors
    ///
    /// [`Fault::Short`], [`Fault::Limit`], [`Fault::Unicode`].
    pub fn wide_string(&mut self, max_units: Option<u32>) -> Result<String, DecodeError> {
        let len = self.len(max_units)? as usize;
        let units = self.numbers::<u16>(len)?.into_iter();
        let text = char::decode_utf16(units).collect::<Result<String, _>>();
        text.map_err(|_| self.wrong(Fault::Unicode))
    }

    /// Takes `len` numbers.
    fn numbers<T: Number>(&mut self, len: usize) -> Result<Vec<T>, DecodeError> {
        if len == 0 {
            return Ok(Vec::new());
        }
        self.align(size_of::<T>())?;
        // On 32-bit machines the product could overflow.
        let at = self.skip(len.saturating_mul(size_of::<T>()))?;
        let numbers = T::copy_all(&self.source, at, len);
        let mut numbers = numbers.ok_or_else(|| self.wrong(Fault::Short))?;
        T::all_in_order(&mut numbers, self.big_endian);
        Ok(numbers)
    }

    /// Takes a sequence of numbers.
    ///
    /// # Errors
    ///
    /// [`Fault::Short`], [`Fault::Limit`].
    pub fn number_sequence<T: Number>(&mut self, max: Option<u32>) -> Result<Vec<T>, DecodeError> {
        let len = self.len(max)? as usize;
        self.numbers(len)
    }

    /// Takes an array of numbers.
    ///
    /// # Errors
    ///
    /// [`Fault::Short`].
    pub fn number_array<T: Number, const N: usize>(&mut self) -> Result<[T; N], DecodeError> {
        let mut numbers = [T::default(); N];
        self.align(size_of::<T>())?;
        if !self.source.copy_to(self.at, numbers.as_mut_bytes()) {
            return Err(self.wrong(Fault::Short));
        }
        self.at += size_of::<[T; N]>();
        T::all_in_order(&mut numbers, self.big_endian);
        Ok(numbers)
    }

    /// Takes `len` elements. The caller knows that the message is long enough for them, or that the number is small.
    ///
    /// # Errors
    ///
    /// The errors of `read`.
    pub fn elements<T>(
        &mut self,
        len: usize,
        mut read: impl FnMut(&mut Self) -> Result<T, DecodeError>,
    ) -> Result<Vec<T>, DecodeError> {
        let mut items = Vec::with_capacity(len);
        for at in 0..len {
            let item = read(self);
            items.push(item.map_err(|error| error.within(&format!("[{at}]")))?);
        }
        Ok(items)
    }

    /// Takes a sequence of elements that have at least `min_bytes` bytes each.
    ///
    /// # Errors
    ///
    /// [`Fault::Short`], [`Fault::Limit`], and the errors of `read`.
    pub fn sequence<T>(
        &mut self,
        max: Option<u32>,
        min_bytes: usize,
        read: impl FnMut(&mut Self) -> Result<T, DecodeError>,
    ) -> Result<Vec<T>, DecodeError> {
        let len = self.len(max)? as usize;
        if len.saturating_mul(min_bytes.max(1)) > self.remaining() {
            return Err(self.wrong(Fault::Short));
        }
        self.elements(len, read)
    }

    /// Takes an array of elements.
    ///
    /// # Errors
    ///
    /// The errors of `read`.
    pub fn array<T: Default, const N: usize>(
        &mut self,
        mut read: impl FnMut(&mut Self) -> Result<T, DecodeError>,
    ) -> Result<[T; N], DecodeError> {
        let mut items = std::array::from_fn(|_| T::default());
        for (at, item) in items.iter_mut().enumerate() {
            *item = read(self).map_err(|error| error.within(&format!("[{at}]")))?;
        }
        Ok(items)
    }

    pub(crate) const fn wrong(&self, fault: Fault) -> DecodeError {
        DecodeError::new(self.at, fault)
    }
}

impl<'a> Reader<&'a [u8]> {
    /// Takes a sequence of numbers, which stay in the message.
    ///
    /// # Errors
    ///
    /// [`Fault::Short`], [`Fault::Limit`].
    pub fn number_view<T: Number>(
        &mut self,
        max: Option<u32>,
    ) -> Result<Numbers<'a, T>, DecodeError> {
        let len = self.len(max)? as usize;
        if len == 0 {
            return Ok(Numbers::new(&[], self.big_endian));
        }
        self.align(size_of::<T>())?;
        let bytes = len.saturating_mul(size_of::<T>());
        let at = self.skip(bytes)?;
        let source = self.source;
        let numbers = source.get(at..).and_then(|it| it.get(..bytes));
        let numbers = numbers.ok_or_else(|| self.wrong(Fault::Short))?;
        Ok(Numbers::new(numbers, self.big_endian))
    }

    /// Takes a text in UTF-8, which stays in the message.
    pub(crate) fn text(&mut self, max_bytes: Option<u32>) -> Result<&'a str, DecodeError> {
        let (at, len) = self.text_place(max_bytes)?;
        let source = self.source;
        let bytes = source.get(at..).and_then(|it| it.get(..len));
        let text = match bytes {
            Some([]) => &[],
            Some([text @ .., 0]) => text,
            _ => return Err(self.wrong(Fault::Unterminated)),
        };
        str::from_utf8(text).map_err(|_| self.wrong(Fault::Unicode))
    }
}
