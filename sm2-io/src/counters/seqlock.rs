//! Words that one writer changes and readers copy, as they were between two changes.
//!
//! The first word is the `turn`: odd while the others are written, 0 if nobody uses them. A
//! reader takes what it copied only if the turn was the same even number before and
//! after. The writer never waits. `turn` must never be one that these words had before.
//!
//! Words are little-endian. `verification/loom` runs this file, as it is, through many
//! executions that the memory model allows.

use crate::sync::{AtomicU64, Ordering, fence};

/// Where the turn stands.
const TURN: usize = 0;

/// A change of the words; it ends, and readers see it, when this is dropped.
#[derive(Debug)]
pub(super) struct Change<'a, const N: usize> {
    words: &'a [AtomicU64; N],
    turn: &'a mut u64,
}

impl<'a, const N: usize> Change<'a, N> {
    /// Starts a change. `turn` is that of the last change of any words that these ever were,
    /// and of no one else: what it becomes is the greatest that there was.
    //= SM2-CNT-005
    #[inline]
    pub(super) fn begin(words: &'a [AtomicU64; N], turn: &'a mut u64) -> Self {
        // Odd, and greater than before, also if the last one was never dropped.
        *turn = (*turn + 1) | 1;
        words[TURN].store(turn.to_le(), Ordering::Relaxed);
        // Pairs with the second fence of a reader: one that copied any word of what follows
        // sees this turn, or a later one, when it looks at the turn again.
        fence(Ordering::Release);
        Self { words, turn }
    }

    /// What stands there. Nobody else writes, so that it needs no order.
    #[inline]
    pub(super) fn get(&self, index: usize) -> u64 {
        u64::from_le(self.words[index].load(Ordering::Relaxed))
    }

    /// Writes a word, if it is another.
    #[inline]
    pub(super) fn set(&mut self, index: usize, value: u64) {
        if self.get(index) != value {
            self.words[index].store(value.to_le(), Ordering::Relaxed);
        }
    }
}

impl<const N: usize> Drop for Change<'_, N> {
    //= SM2-CNT-005
    #[inline]
    fn drop(&mut self) {
        *self.turn += 1;
        // Pairs with the first fence of a reader: one that sees this turn sees all words
        // that were written before.
        self.words[TURN].store(self.turn.to_le(), Ordering::Release);
    }
}

/// Ends the use of the words.
//= SM2-CNT-005
pub(super) fn free<const N: usize>(words: &[AtomicU64; N]) {
    // The other words stay: who reads them sees that the turn has changed.
    words[TURN].store(0, Ordering::Relaxed);
}

/// Copies the words, if they belong together and the copy was not disturbed.
//= SM2-CNT-005
pub(super) fn copy<const N: usize>(words: &[AtomicU64; N]) -> Option<[u64; N]> {
    // Relaxed: the only ordering that Rust promises for read-only memory.
    let word = |index: usize| u64::from_le(words[index].load(Ordering::Relaxed));
    let turn = word(TURN);
    if turn % 2 == 1 {
        return None;
    }
    // Pairs with the end of a change: who sees its turn sees what it wrote.
    fence(Ordering::Acquire);
    let mut copied: [u64; N] = std::array::from_fn(word);
    // Pairs with the start of a change: who saw any of it sees its turn.
    fence(Ordering::Acquire);
    if word(TURN) != turn {
        return None;
    }
    // The copy in between is another reading, which a hostile writer can make differ.
    copied[TURN] = turn;
    Some(copied)
}
