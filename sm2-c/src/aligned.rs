//! Copies of messages that are not aligned.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// The alignment of every message that the program reads or writes, in bytes: that of a slot.
const ALIGNMENT: usize = 64;

#[derive(Clone, Copy, Debug, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C, align(64))]
struct Line([u8; ALIGNMENT]);

/// A copy of a message that arrived in a datagram, if it is not aligned there. Keeps its memory for the next one.
#[derive(Debug, Default)]
pub(crate) struct AlignedCopy {
    lines: Vec<Line>,
    is_used: bool,
}

impl AlignedCopy {
    /// Copies the message if it is not aligned.
    pub(crate) fn align(&mut self, message: &[u8]) {
        self.is_used = !message.as_ptr().addr().is_multiple_of(ALIGNMENT);
        if self.is_used {
            let line = Line([0; ALIGNMENT]);
            self.lines.resize(message.len().div_ceil(ALIGNMENT), line);
            self.lines.as_mut_bytes()[..message.len()].copy_from_slice(message);
        }
    }

    /// The bytes of the message that [`align`](Self::align) got: the message itself if it is aligned.
    pub(crate) fn of<'a>(&'a self, message: &'a [u8]) -> &'a [u8] {
        match self.is_used {
            true => &self.lines.as_bytes()[..message.len()],
            false => message,
        }
    }
}
