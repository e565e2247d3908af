//! The shared memory that a driver lends to a link for one call.
//!
//! The machine decides, and the driver lends it memory: its rings, for the length of one call. The machine calls the
//! four operations of `RingMemory` and judges their results, so the whole protocol of the ring is pure code, parking
//! included. (A side *parks* when it marks in the ring that it is about to sleep.) This code runs against loom's
//! atomics, against a hostile memory in tests, and against the real file in `sm2-io/src/ring.rs`.

use core::convert::Infallible;

use super::{At, RingMemory, SlotRange};
use crate::limits::SLOT_HEAD;

/// The mapped memory of one link. The socket lane does not touch it, so [`NoMemory`] suffices
/// there.
pub trait LinkMemory {
    /// A ring that is mapped.
    type Ring: RingMemory;

    /// Whether [`prefetch`](Self::prefetch) does something. If not, nothing is read for it: models and tests see the
    /// accesses that the protocol needs alone.
    const PREFETCHES: bool = false;

    /// The ring that this end sends through, if it is mapped.
    fn outgoing(&self) -> Option<&Self::Ring>;

    /// The ring that this end takes messages from, if it is mapped.
    fn incoming(&self) -> Option<&Self::Ring>;

    /// Copies the last 64 bytes of this slot. `None` if the segment is not mapped.
    fn slot_head(&self, slot: SlotRange) -> Option<[u8; SLOT_HEAD]>;

    /// Called before the word that names this slot is taken, if possible while the message before it is handled. The
    /// processor executes no read before the atomic operation that takes the word, and the slot is in the cache of the
    /// sender's core: a prefetch overlaps its transfer with what happens before.
    #[inline]
    fn prefetch(&self, _slot: SlotRange) {}
}

/// One ring that serves both directions, without segments. A link can send through it and give
/// messages back through it, but cannot take a message, because no slot can be read.
impl<R: RingMemory> LinkMemory for R {
    type Ring = R;

    #[inline]
    fn outgoing(&self) -> Option<&R> {
        Some(self)
    }

    #[inline]
    fn incoming(&self) -> Option<&R> {
        Some(self)
    }

    fn slot_head(&self, _: SlotRange) -> Option<[u8; SLOT_HEAD]> {
        None
    }
}

/// One ring that serves both directions, and a function that copies the heads of slots.
#[derive(Clone, Copy, Debug)]
pub struct LentRing<'a, R, F> {
    ring: &'a R,
    head: F,
}

impl<'a, R, F> LentRing<'a, R, F> {
    /// Lends this ring. `head` implements [`LinkMemory::slot_head`].
    #[inline]
    pub const fn new(ring: &'a R, head: F) -> Self {
        Self { ring, head }
    }
}

impl<R, F> LinkMemory for LentRing<'_, R, F>
where
    R: RingMemory,
    F: Fn(SlotRange) -> Option<[u8; SLOT_HEAD]>,
{
    type Ring = R;

    #[inline]
    fn outgoing(&self) -> Option<&R> {
        Some(self.ring)
    }

    #[inline]
    fn incoming(&self) -> Option<&R> {
        Some(self.ring)
    }

    #[inline]
    fn slot_head(&self, slot: SlotRange) -> Option<[u8; SLOT_HEAD]> {
        (self.head)(slot)
    }
}

/// No memory, for links of the socket lane.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NoMemory;

/// The ring of [`NoMemory`]. The type has no values.
#[derive(Debug)]
pub struct NoRing(Infallible);

impl LinkMemory for NoMemory {
    type Ring = NoRing;

    fn outgoing(&self) -> Option<&NoRing> {
        None
    }

    fn incoming(&self) -> Option<&NoRing> {
        None
    }

    fn slot_head(&self, _: SlotRange) -> Option<[u8; SLOT_HEAD]> {
        None
    }
}

impl RingMemory for NoRing {
    fn load(&self, _: At) -> u64 {
        match self.0 {}
    }

    fn swap(&self, _: At, _: u64) -> u64 {
        match self.0 {}
    }

    fn take(&self, _: At, _: u64) -> bool {
        match self.0 {}
    }

    fn write_cell(&self, _: u32, _: &[u64]) {
        match self.0 {}
    }

    fn read_cell(&self, _: u32, _: &mut [u64]) {
        match self.0 {}
    }

    fn fence(&self) {
        match self.0 {}
    }
}
