//! The operations on words that two processes write.
//!
//! `verification/loom` runs this file, as it is, through many executions that the memory
//! model allows. Words are little-endian.

use crate::sync::{AtomicU64, Ordering, fence};

/// Reads a word.
#[inline]
pub(super) fn load(word: &AtomicU64) -> u64 {
    // Acquire: pairs with the release of the `swap` or `take` that wrote this word, so that the
    // writes before that are visible.
    u64::from_le(word.load(Ordering::Acquire))
}

/// Writes a word, and returns the one that it replaces.
#[inline]
pub(super) fn swap(word: &AtomicU64, bits: u64) -> u64 {
    // Release: pairs with the acquire of the `take` or `load` of the other side, which then sees
    // the message that the word names. Acquire: pairs with the release of the `swap` or `take`
    // that wrote the replaced word on the other side; its reads of the named slot are over then, so
    // that the slot can be written again.
    u64::from_le(word.swap(bits.to_le(), Ordering::AcqRel))
}

/// Replaces the word by 0 if it is `bits`. Returns whether it was.
#[inline]
pub(super) fn take(word: &AtomicU64, bits: u64) -> bool {
    // Acquire: pairs with the release of the `swap` that wrote `bits`, so that the message is
    // visible. Release: pairs with the acquire of the next `swap` of this word. A failed exchange
    // reads nothing that the caller uses, so it is relaxed.
    let taken = word.compare_exchange(bits.to_le(), 0, Ordering::AcqRel, Ordering::Relaxed);
    taken.is_ok()
}

/// Writes the words of a cell.
#[inline]
pub(super) fn write(cell: &[AtomicU64], words: &[u64]) {
    for (place, word) in cell.iter().zip(words) {
        // Relaxed: the `swap` of the forward word that follows releases it. The `load` or `swap` that found the forward
        // word empty has acquired the `take` of the message before, so that the reads of that one are over.
        place.store(word.to_le(), Ordering::Relaxed);
    }
}

/// Reads the words of a cell.
#[inline]
pub(super) fn read(cell: &[AtomicU64], words: &mut [u64]) {
    for (word, place) in words.iter_mut().zip(cell) {
        // Relaxed: the `load` of the forward word has acquired them. If the sender writes them again meanwhile, it has
        // swapped the forward word out before, and the `take` that follows fails. If that succeeds, it releases these
        // reads.
        *word = u64::from_le(place.load(Ordering::Relaxed));
    }
}

/// Orders the writes before it against the reads after it, for all threads alike.
#[inline]
pub(super) fn order() {
    // Pairs with the same fence on the other side: one side writes a message word and then reads the
    // parked word, the other writes the parked word and then reads the message word. At least one of
    // them sees the write of the other, so that no wake-up is lost (SM2-RNG-012).
    fence(Ordering::SeqCst);
}
