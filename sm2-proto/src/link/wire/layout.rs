//! A header of fixed length. The compiler checks that every field lies within the header, so no
//! offset can fail at run time.

use core::array;

use super::super::{FrameKind, Head};
use crate::Violation;

/// A header of `N` bytes.
#[derive(Clone, Copy)]
pub(super) struct Layout<const N: usize>([u8; N]);

impl<const N: usize> Layout<N> {
    /// Reads a frame that consists of its header only.
    pub(super) fn exactly(bytes: &[u8]) -> Result<Self, Violation> {
        bytes
            .try_into()
            .map(Self)
            .map_err(|_| violation!(BadLength, "SM2-WIR-001"))
    }

    /// Reads the header at the start of a frame. Returns the header and the bytes after it.
    pub(super) fn split(bytes: &[u8]) -> Result<(Self, &[u8]), Violation> {
        let (head, rest) = bytes
            .split_first_chunk()
            .ok_or(violation!(BadLength, "SM2-WIR-001"))?;
        Ok((Self(*head), rest))
    }

    /// Creates a header of this kind with all other bytes zero.
    pub(super) fn of(kind: FrameKind) -> Self {
        Self([0; N]).with::<0, 1>([kind as u8])
    }

    fn field<const AT: usize, const W: usize>(&self) -> [u8; W] {
        const { assert!(AT + W <= N) };
        array::from_fn(|index| self.0[AT + index])
    }

    pub(super) fn u8<const AT: usize>(&self) -> u8 {
        u8::from_le_bytes(self.field::<AT, 1>())
    }

    pub(super) fn u16<const AT: usize>(&self) -> u16 {
        u16::from_le_bytes(self.field::<AT, 2>())
    }

    pub(super) fn u32<const AT: usize>(&self) -> u32 {
        u32::from_le_bytes(self.field::<AT, 4>())
    }

    pub(super) fn u64<const AT: usize>(&self) -> u64 {
        u64::from_le_bytes(self.field::<AT, 8>())
    }

    /// Checks that the `W` reserved bytes from `AT` are zero.
    //= SM2-WIR-001
    pub(super) fn check_zero<const AT: usize, const W: usize>(&self) -> Result<(), Violation> {
        if self.field::<AT, W>() == [0; W] {
            Ok(())
        } else {
            Err(violation!(ReservedNotZero, "SM2-WIR-001"))
        }
    }

    /// Returns the header with this field set.
    pub(super) fn with<const AT: usize, const W: usize>(mut self, field: [u8; W]) -> Self {
        const { assert!(AT + W <= N) };
        self.0[AT..AT + W].copy_from_slice(&field);
        self
    }

    pub(super) fn head(&self) -> Head {
        Head::new(&self.0)
    }
}
