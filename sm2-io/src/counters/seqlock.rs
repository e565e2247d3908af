//! A seqlock: one writer changes words, and readers copy them as they were between two changes.
//!
//! The first word is the `turn`: odd while the writer changes the others, 0 while they are unused. A
//! reader accepts its copy only if the turn was the same even number before and after the copy. The
//! writer never waits. A turn never repeats for the same words.
//!
//! Words are little-endian. `verification/loom` runs this file, as it is, through many
//! executions that the memory model allows.

use crate::sync::{AtomicU64, Ordering, fence};

/// The index of the turn.
const TURN: usize = 0;

/// A change of the words. It ends, and readers see it, when this value is dropped.
#[derive(Debug)]
pub(super) struct Change<'a, const N: usize> {
    words: &'a [AtomicU64; N],
    turn: &'a mut u64,
}

impl<'a, const N: usize> Change<'a, N> {
    /// Starts a change. `turn` is the turn of the last change of these words; the change raises it, so
    /// that it is greater than every turn before.
    //= SM2-CNT-006
    #[inline]
    pub(super) fn begin(words: &'a [AtomicU64; N], turn: &'a mut u64) -> Self {
        // Odd, and greater than before, even if the last change was never dropped.
        *turn = (*turn + 1) | 1;
        words[TURN].store(turn.to_le(), Ordering::Relaxed);
        // Pairs with the second acquire fence in `copy`: a reader that copied any word which this
        // change writes sees this turn, or a later one, when it loads the turn again.
        fence(Ordering::Release);
        Self { words, turn }
    }

    /// The value of a word. Relaxed: this process is the only writer.
    #[inline]
    pub(super) fn get(&self, index: usize) -> u64 {
        u64::from_le(self.words[index].load(Ordering::Relaxed))
    }

    /// Writes a word if its value differs. Relaxed: the turn orders it.
    #[inline]
    pub(super) fn set(&mut self, index: usize, value: u64) {
        if self.get(index) != value {
            self.put(index, value);
        }
    }

    /// Writes a word. Relaxed: the turn orders it.
    #[inline]
    pub(super) fn put(&mut self, index: usize, value: u64) {
        self.words[index].store(value.to_le(), Ordering::Relaxed);
    }
}

impl<const N: usize> Drop for Change<'_, N> {
    //= SM2-CNT-006
    #[inline]
    fn drop(&mut self) {
        *self.turn += 1;
        // Pairs with the first acquire fence in `copy`: a reader that sees this turn sees all words
        // that the change wrote.
        self.words[TURN].store(self.turn.to_le(), Ordering::Release);
    }
}

/// Marks the words as unused.
//= SM2-CNT-006
pub(super) fn free<const N: usize>(words: &[AtomicU64; N]) {
    // The other words stay: a reader that is copying them sees that the turn has changed. Relaxed:
    // nothing else has to be visible with it.
    words[TURN].store(0, Ordering::Relaxed);
}

/// Copies the words; `None` if a change was going on.
//= SM2-CNT-006
pub(super) fn copy<const N: usize>(words: &[AtomicU64; N]) -> Option<[u64; N]> {
    // Relaxed: the only ordering that Rust promises for read-only memory.
    let word = |index: usize| u64::from_le(words[index].load(Ordering::Relaxed));
    let turn = word(TURN);
    if turn % 2 == 1 {
        return None;
    }
    // Pairs with the release store in `Change::drop`: the words of the change with this turn are
    // visible.
    fence(Ordering::Acquire);
    let mut copied: [u64; N] = std::array::from_fn(word);
    // Pairs with the release fence in `Change::begin`: if the copy has a word of a later change, the
    // next load sees the turn of that change.
    fence(Ordering::Acquire);
    if word(TURN) != turn {
        return None;
    }
    // The copy read the turn once more, and a hostile writer can make that reading differ.
    copied[TURN] = turn;
    Some(copied)
}
