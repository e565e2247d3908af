//! The keys under which an outbox stores messages.

/// The key of a stored message: the index of an entry in the outbox, and how often that entry was
/// used. A stale key therefore names no message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct MessageKey {
    pub(super) generation: u32,
    pub(super) index: u32,
}

impl MessageKey {
    /// Encodes the key for the machine of a link.
    pub(in crate::driver) const fn to_raw(self) -> u64 {
        (self.generation as u64) << 32 | self.index as u64
    }

    /// Decodes a key that [`to_raw`](Self::to_raw) encoded.
    pub(in crate::driver) const fn from_raw(raw: u64) -> Self {
        Self {
            generation: (raw >> 32) as u32,
            index: raw as u32,
        }
    }
}
