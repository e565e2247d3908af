//! Private memory that is aligned for plain old data.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Bytes that are aligned to 64.
pub(crate) struct AlignedBuffer {
    lines: Vec<Line>,
    len: usize,
}

#[derive(Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C, align(64))]
struct Line([u8; 64]);

impl AlignedBuffer {
    /// Allocates `len` zeroes.
    pub(crate) fn zeroed(len: usize) -> Self {
        let lines = vec![Line([0; 64]); len.div_ceil(size_of::<Line>())];
        Self { lines, len }
    }

    pub(crate) fn copy_of(bytes: &[u8]) -> Self {
        let mut copy = Self::zeroed(bytes.len());
        copy.as_mut_slice().copy_from_slice(bytes);
        copy
    }

    pub(crate) fn as_slice(&self) -> &[u8] {
        &self.lines.as_bytes()[..self.len]
    }

    pub(crate) fn as_mut_slice(&mut self) -> &mut [u8] {
        &mut self.lines.as_mut_bytes()[..self.len]
    }
}

impl AsRef<[u8]> for AlignedBuffer {
    fn as_ref(&self) -> &[u8] {
        self.as_slice()
    }
}
