//! Access to the words of a ring.

use super::At;

/// The words of one ring, in memory that the other end writes as well.
///
/// All operations are atomic. [`load`](Self::load) has acquire ordering; [`swap`](Self::swap) and
/// [`take`](Self::take) have acquire and release ordering. The machine asks only for words in the
/// ring's [layout](super::RingLayout).
pub trait RingMemory {
    /// Reads a word.
    fn load(&self, at: At) -> u64;
    /// Writes a word, and returns the previous value.
    fn swap(&self, at: At, bits: u64) -> u64;
    /// Replaces `bits` by [`EMPTY`](super::EMPTY) if the word still has this value. Returns whether
    /// it had.
    fn take(&self, at: At, bits: u64) -> bool;
    /// Writes the words of the cell behind this forward word, from the first on. Relaxed: the [`swap`](Self::swap) of
    /// the forward word that follows publishes them.
    fn write_cell(&self, index: u32, words: &[u64]);
    /// Reads the words of the cell behind this forward word, from the first on. Relaxed: a [`load`](Self::load) of the
    /// forward word came before. The other side may write them meanwhile; then the [`take`](Self::take) that follows
    /// fails.
    fn read_cell(&self, index: u32, words: &mut [u64]);
    /// A sequentially consistent fence. The last access of this thread to a word was a [`swap`](Self::swap) or a
    /// [`take`](Self::take).
    fn fence(&self);
    /// Called before a word is taken or replaced: the other side's core has it, and a prefetch overlaps its transfer
    /// with what happens before.
    #[inline]
    fn prefetch(&self, _at: At) {}
}
