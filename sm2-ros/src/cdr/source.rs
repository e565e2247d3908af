//! Where the bytes of a message are.

/// Bytes that can be copied, but not referred to, because another process may change them meanwhile.
#[expect(clippy::len_without_is_empty, reason = "only the length is needed")]
pub trait Source {
    /// The number of bytes, always the same.
    fn len(&self) -> usize;

    /// Copies the bytes from `at` on. Returns false if they are not all inside.
    #[must_use]
    fn copy_to(&self, at: usize, to: &mut [u8]) -> bool;

    /// Returns a copy of `len` bytes from `at` on; `None` if they are not all inside.
    #[must_use]
    fn to_vec(&self, at: usize, len: usize) -> Option<Vec<u8>>;
}

impl Source for &[u8] {
    #[inline]
    fn len(&self) -> usize {
        <[u8]>::len(self)
    }

    #[inline]
    fn copy_to(&self, at: usize, to: &mut [u8]) -> bool {
        match self.get(at..).and_then(|it| it.get(..to.len())) {
            Some(bytes) => {
                to.copy_from_slice(bytes);
                true
            }
            None => false,
        }
    }

    fn to_vec(&self, at: usize, len: usize) -> Option<Vec<u8>> {
        let bytes = self.get(at..)?.get(..len)?;
        Some(bytes.to_vec())
    }
}
