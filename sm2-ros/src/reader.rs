//! Reads the bytes of CDR, one value after the other.

use std::borrow::Cow;

use crate::{DecodeError, Fault};

/// The bytes in front of a message: a version and the byte order, and two bytes of options.
pub(crate) const HEADER_BYTES: usize = 4;

/// A message, and the place of the next value.
pub(crate) struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
    big_endian: bool,
}

impl<'a> Reader<'a> {
    /// Reads the header.
    pub(crate) fn new(bytes: &'a [u8]) -> Result<Self, DecodeError> {
        let big_endian = match bytes {
            [0, 0, _, _, ..] => true,
            [0, 1, _, _, ..] => false,
            _ => return Err(DecodeError::new(0, Fault::Header)),
        };
        Ok(Self {
            bytes,
            at: HEADER_BYTES,
            big_endian,
        })
    }

    /// Checks that the message ends here. ROS 2 may fill the last four bytes.
    pub(crate) const fn end(&self) -> Result<(), DecodeError> {
        match self.remaining() {
            0..4 => Ok(()),
            rest => Err(self.wrong(Fault::LeftOver(rest))),
        }
    }

    pub(crate) const fn remaining(&self) -> usize {
        self.bytes.len() - self.at
    }

    /// Skips to the next multiple of `size`, a power of two, counted from the end of the header.
    pub(crate) fn align(&mut self, size: usize) -> Result<(), DecodeError> {
        let offset = self.at - HEADER_BYTES;
        let skip = offset.next_multiple_of(size) - offset;
        self.take(skip).map(drop)
    }

    /// Takes bytes as they are.
    pub(crate) fn take(&mut self, len: usize) -> Result<&'a [u8], DecodeError> {
        let bytes = self.bytes.get(self.at..).and_then(|it| it.get(..len));
        let bytes = bytes.ok_or_else(|| self.wrong(Fault::Short))?;
        self.at += len;
        Ok(bytes)
    }

    /// Takes an aligned number as little-endian bytes.
    pub(crate) fn number<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        self.align(N)?;
        let mut number = [0; N];
        number.copy_from_slice(self.take(N)?);
        if self.big_endian {
            number.reverse();
        }
        Ok(number)
    }

    /// Takes the length of a text or sequence.
    pub(crate) fn len(&mut self, max: Option<u32>) -> Result<u32, DecodeError> {
        let len = u32::from_le_bytes(self.number()?);
        self.check(len, max)?;
        Ok(len)
    }

    fn check(&self, len: u32, max: Option<u32>) -> Result<(), DecodeError> {
        match max {
            Some(max) if len > max => Err(self.wrong(Fault::Limit { len, max })),
            _ => Ok(()),
        }
    }

    pub(crate) fn bool(&mut self) -> Result<bool, DecodeError> {
        match self.take(1)? {
            [0] => Ok(false),
            [1] => Ok(true),
            other => Err(self.wrong(Fault::Bool(other.first().copied().unwrap_or(0)))),
        }
    }

    /// Takes a text in UTF-8. Some programs write an empty text with length 0, without the byte 0.
    pub(crate) fn text(&mut self, max_bytes: Option<u32>) -> Result<&'a str, DecodeError> {
        let len = self.len(None)?;
        self.check(len.saturating_sub(1), max_bytes)?;
        let bytes = self.take(len as usize)?;
        let text = match bytes {
            [] => bytes,
            [text @ .., 0] => text,
            _ => return Err(self.wrong(Fault::Unterminated)),
        };
        str::from_utf8(text).map_err(|_| self.wrong(Fault::Unicode))
    }

    /// Takes a text in UTF-16, whose length counts units of 16 bits.
    pub(crate) fn wide_text(
        &mut self,
        max_units: Option<u32>,
    ) -> Result<Cow<'a, str>, DecodeError> {
        let len = self.len(max_units)? as usize;
        // The bytes are there before the text is allocated. On 32-bit machines the product could overflow.
        let bytes = self.take(len.saturating_mul(2))?;
        let units = bytes
            .chunks_exact(2)
            .map(|unit| match (unit, self.big_endian) {
                ([high, low], true) | ([low, high], false) => u16::from_le_bytes([*low, *high]),
                _ => 0,
            });
        let text = char::decode_utf16(units).collect::<Result<String, _>>();
        text.map(Cow::Owned).map_err(|_| self.wrong(Fault::Unicode))
    }

    pub(crate) const fn wrong(&self, fault: Fault) -> DecodeError {
        DecodeError::new(self.at, fault)
    }
}
