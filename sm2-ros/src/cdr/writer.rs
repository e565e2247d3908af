//! Writes the bytes of CDR, little-endian, one value after the other.

use zerocopy::IntoBytes;

use super::Number;
use crate::{EncodeError, FieldPath};

/// The bytes in front of a message: a version and the byte order, and two bytes of options.
pub(crate) const HEADER_BYTES: usize = 4;

/// Receives the bytes of a message.
pub trait Sink {
    /// Appends these bytes.
    fn put(&mut self, bytes: &[u8]);
}

impl Sink for Vec<u8> {
    #[inline]
    fn put(&mut self, bytes: &[u8]) {
        self.extend_from_slice(bytes);
    }
}

/// Discards the bytes of a message: its [`Writer`] counts them.
#[derive(Clone, Copy, Debug)]
pub struct Discard;

impl Sink for Discard {
    #[inline]
    fn put(&mut self, _: &[u8]) {}
}

/// The part of a slice that is not written yet. Bytes without room are discarded.
#[derive(Debug)]
pub(crate) struct Rest<'a>(pub(crate) &'a mut [u8]);

impl Sink for Rest<'_> {
    #[inline]
    fn put(&mut self, bytes: &[u8]) {
        let rest = std::mem::take(&mut self.0);
        if let Some((place, rest)) = rest.split_at_mut_checked(bytes.len()) {
            place.copy_from_slice(bytes);
            self.0 = rest;
        }
    }
}

/// A message that is being written.
#[derive(Debug)]
pub struct Writer<S> {
    sink: S,
    /// The number of bytes behind the header.
    offset: usize,
}

impl<S: Sink> Writer<S> {
    /// Writes the header.
    pub fn new(mut sink: S) -> Self {
        sink.put(&[0, 1, 0, 0]);
        Self { sink, offset: 0 }
    }

    /// The number of bytes that were written, with the header.
    pub const fn len_bytes(&self) -> usize {
        HEADER_BYTES + self.offset
    }

    /// Returns the sink.
    pub fn into_sink(self) -> S {
        self.sink
    }

    #[inline]
    fn put(&mut self, bytes: &[u8]) {
        self.sink.put(bytes);
        self.offset += bytes.len();
    }

    #[inline]
    fn align(&mut self, size: usize) {
        let skip = self.offset.next_multiple_of(size) - self.offset;
        self.put([0; 8].get(..skip).unwrap_or_default());
    }

    /// Writes an aligned number.
    #[inline]
    pub fn number<T: Number>(&mut self, number: T) {
        self.numbers(&[number]);
    }

    /// Writes a boolean.
    #[inline]
    pub fn bool(&mut self, value: bool) {
        self.number(u8::from(value));
    }

    /// Writes numbers, such as those of an array.
    #[inline]
    pub fn numbers<T: Number>(&mut self, numbers: &[T]) {
        if numbers.is_empty() {
            return;
        }
        self.align(size_of::<T>());
        if cfg!(target_endian = "little") {
            self.put(numbers.as_bytes());
        } else {
            for number in numbers {
                self.put(number.in_order(false).as_bytes());
            }
        }
    }

    /// Writes numbers of `size` bytes, a power of two, whose bytes are in little-endian order already.
    pub fn number_bytes(&mut self, bytes: &[u8], size: usize) {
        if !bytes.is_empty() {
            self.align(size);
            self.put(bytes);
        }
    }

    /// Writes numbers of `size` bytes whose value is zero.
    pub(crate) fn zeros(&mut self, len: usize, size: usize) {
        if len == 0 {
            return;
        }
        self.align(size);
        let mut left = len * size;
        while left > 0 {
            let zeros = [0; 4_096];
            let now = zeros.get(..left).unwrap_or(&zeros);
            self.put(now);
            left -= now.len();
        }
    }

    /// Writes a text in UTF-8.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Limit`] if it has more than `max_bytes` bytes.
    pub fn text(&mut self, text: &str, max_bytes: Option<u32>) -> Result<(), EncodeError> {
        check(text.len(), max_bytes)?;
        self.len(text.len() + 1, None)?;
        self.put(text.as_bytes());
        self.put(&[0]);
        Ok(())
    }

    /// Writes a text in UTF-16, whose length counts units of 16 bits.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Limit`] if it has more than `max_units` units.
    pub fn wide_text(&mut self, text: &str, max_units: Option<u32>) -> Result<(), EncodeError> {
        self.len(text.encode_utf16().count(), max_units)?;
        for unit in text.encode_utf16() {
            self.number(unit);
        }
        Ok(())
    }

    /// Writes the length of a sequence, whose elements follow.
    ///
    /// # Errors
    ///
    /// [`EncodeError::Limit`] if it is above `max`, or has no encoding in 32 bits.
    pub fn len(&mut self, len: usize, max: Option<u32>) -> Result<(), EncodeError> {
        self.number(check(len, max)?);
        Ok(())
    }

    /// Writes a sequence of numbers.
    ///
    /// # Errors
    ///
    /// As [`len`](Self::len).
    pub fn number_sequence<T: Number>(
        &mut self,
        numbers: &[T],
        max: Option<u32>,
    ) -> Result<(), EncodeError> {
        self.len(numbers.len(), max)?;
        self.numbers(numbers);
        Ok(())
    }

    /// Writes a sequence of elements by a function.
    ///
    /// # Errors
    ///
    /// As [`len`](Self::len), and the errors of `write`.
    pub fn sequence<T>(
        &mut self,
        items: &[T],
        max: Option<u32>,
        write: impl FnMut(&mut Self, &T) -> Result<(), EncodeError>,
    ) -> Result<(), EncodeError> {
        self.len(items.len(), max)?;
        self.each(items, write)
    }

    /// Writes elements by a function, such as those of an array.
    ///
    /// # Errors
    ///
    /// The errors of `write`.
    pub fn each<T>(
        &mut self,
        items: &[T],
        mut write: impl FnMut(&mut Self, &T) -> Result<(), EncodeError>,
    ) -> Result<(), EncodeError> {
        for (at, item) in items.iter().enumerate() {
            write(self, item).map_err(|error| error.within(&format!("[{at}]")))?;
        }
        Ok(())
    }
}

fn check(len: usize, max: Option<u32>) -> Result<u32, EncodeError> {
    let max = max.unwrap_or(u32::MAX);
    match u32::try_from(len) {
        Ok(len) if len <= max => Ok(len),
        _ => Err(EncodeError::Limit {
            path: FieldPath::MESSAGE,
            len,
            max,
        }),
    }
}
