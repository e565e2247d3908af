//! The keys under which an outbox stores messages.

/// The key of a stored message: an entry of the outbox, and how often that entry was used. So a
/// key that is kept for too long names no message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct MessageKey {
    pub(super) generation: u32,
    pub(super) index: u32,
}

impl MessageKey {
    /// The key as the machine of a link carries it.
    pub(super) const fn to_raw(self) -> u64 {
        (self.generation as u64) << 32 | self.index as u64
    }

    /// The key that [`to_raw`](Self::to_raw) gave to the machine of a link.
    pub(super) const fn from_raw(raw: u64) -> Self {
        Self {
            generation: (raw >> 32) as u32,
            index: raw as u32,
        }
    }
}
