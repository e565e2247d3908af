//! The operations on the words of a ring.

use super::At;

/// The words of one ring, in memory that the other end writes too.
///
/// All operations are atomic. [`load`](Self::load) acquires; [`swap`](Self::swap) and
/// [`take`](Self::take) acquire and release. The machine only asks for words that are in the ring's
/// [layout](super::RingLayout).
pub trait RingMemory {
    /// Reads a word.
    fn load(&self, at: At) -> u64;
    /// Writes a word, and returns the word that was there.
    fn swap(&self, at: At, bits: u64) -> u64;
    /// Writes [`EMPTY`](super::EMPTY) if `bits` are still there; returns whether they were.
    fn take(&self, at: At, bits: u64) -> bool;
    /// A sequentially consistent fence.
    fn fence(&self);
}
