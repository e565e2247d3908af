//! What two processes do with one word that both can write.
//!
//! `verification/loom` runs this file, as it is, through many executions that the memory
//! model allows. Words are little-endian.

use crate::sync::{AtomicU64, Ordering, fence};

/// Reads a word.
#[inline]
pub(super) fn load(word: &AtomicU64) -> u64 {
    // Pairs with the release of who wrote it: what it wrote before is seen.
    u64::from_le(word.load(Ordering::Acquire))
}

/// Writes a word, and gives the one that was there.
#[inline]
pub(super) fn swap(word: &AtomicU64, bits: u64) -> u64 {
    // Release: whoever takes it sees the message. Acquire: who took out a word before has read
    // what it named, so that it can be written again.
    u64::from_le(word.swap(bits.to_le(), Ordering::AcqRel))
}

/// Writes 0 if `bits` are still there; whether they were.
#[inline]
pub(super) fn take(word: &AtomicU64, bits: u64) -> bool {
    let taken = word.compare_exchange(bits.to_le(), 0, Ordering::AcqRel, Ordering::Relaxed);
    taken.is_ok()
}

/// Orders what was written before against what is read after, for all threads alike.
#[inline]
pub(super) fn order() {
    fence(Ordering::SeqCst);
}
