//! Sequences of numbers that stay where the message is.

use std::fmt;
use std::marker::PhantomData;

use zerocopy::FromBytes;

use super::Number;

/// A sequence of numbers in the bytes of a message, such as the pixels of an image.
///
/// [`as_slice`](Self::as_slice) refers to the numbers in place. The other methods work with any alignment and byte
/// order.
#[derive(Clone, Copy)]
pub struct Numbers<'a, T> {
    bytes: &'a [u8],
    big_endian: bool,
    numbers: PhantomData<T>,
}

impl<'a, T: Number> Numbers<'a, T> {
    /// `bytes` are whole numbers.
    pub(super) const fn new(bytes: &'a [u8], big_endian: bool) -> Self {
        Self {
            bytes,
            big_endian,
            numbers: PhantomData,
        }
    }

    /// How many numbers there are.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.bytes.len() / size_of::<T>()
    }

    /// Whether there is no number.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.bytes.is_empty()
    }

    /// The numbers in place. `None` if they are in the byte order of another machine, or not aligned in memory. Numbers
    /// of one byte always have a slice. Those of two and four bytes have one in a message of this byte order that SM2
    /// delivers. Those of eight bytes mostly have none, because four bytes stand before the first field of a message.
    #[must_use]
    pub fn as_slice(&self) -> Option<&'a [T]> {
        let is_native = size_of::<T>() == 1 || self.big_endian == cfg!(target_endian = "big");
        let numbers = is_native.then(|| <[T]>::ref_from_bytes(self.bytes).ok());
        numbers.flatten()
    }

    /// A number, by its place; `None` beyond the end.
    #[must_use]
    #[inline]
    pub fn get(&self, at: usize) -> Option<T> {
        let start = at.checked_mul(size_of::<T>())?;
        let (number, _) = T::read_from_prefix(self.bytes.get(start..)?).ok()?;
        Some(number.in_order(self.big_endian))
    }

    /// All numbers in their order.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = T> + use<'a, T> {
        let big_endian = self.big_endian;
        let parts = self.bytes.chunks_exact(size_of::<T>());
        parts.map(move |part| {
            let number = T::read_from_bytes(part).unwrap_or_default();
            number.in_order(big_endian)
        })
    }

    /// A copy of the numbers.
    #[must_use]
    pub fn to_vec(&self) -> Vec<T> {
        self.iter().collect()
    }
}

impl<T: Number> fmt::Debug for Numbers<'_, T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_list().entries(self.iter()).finish()
    }
}
