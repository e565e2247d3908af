//! Writes the bytes of CDR, little-endian, one value after the other.

use crate::reader::HEADER_BYTES;

/// A message that is being written.
pub(crate) struct Writer {
    bytes: Vec<u8>,
}

impl Writer {
    /// The longest message that is written, in bytes. Definitions can ask for more by themselves, with large
    /// arrays.
    pub(crate) const MAX_BYTES: usize = 1 << 28;

    /// Writes the header.
    pub(crate) fn new() -> Self {
        let bytes = vec![0, 1, 0, 0];
        Self { bytes }
    }

    pub(crate) fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }

    /// Whether this number of further bytes is allowed.
    pub(crate) const fn has_room(&self, bytes: usize) -> bool {
        bytes <= Self::MAX_BYTES.saturating_sub(self.bytes.len())
    }

    /// Writes an aligned number, which is given as little-endian bytes.
    pub(crate) fn number<const N: usize>(&mut self, number: [u8; N]) {
        let offset = self.bytes.len() - HEADER_BYTES;
        let len = HEADER_BYTES + offset.next_multiple_of(N);
        self.bytes.resize(len, 0);
        self.bytes.extend_from_slice(&number);
    }

    pub(crate) fn text(&mut self, text: &str) {
        self.number(length(text.len() + 1));
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.push(0);
    }

    /// Writes a text in UTF-16, whose length counts units of 16 bits.
    pub(crate) fn wide_text(&mut self, text: &str) {
        self.number(length(text.encode_utf16().count()));
        for unit in text.encode_utf16() {
            self.number(unit.to_le_bytes());
        }
    }

    pub(crate) fn len(&mut self, len: usize) {
        self.number(length(len));
    }
}

/// Lengths are below `MAX_BYTES`, which the caller has checked.
fn length(len: usize) -> [u8; 4] {
    u32::try_from(len).unwrap_or(u32::MAX).to_le_bytes()
}
