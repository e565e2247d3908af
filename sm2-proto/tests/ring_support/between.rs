//! Ring words that run another operation just before one of their accesses.

use std::cell::{Cell, RefCell};

use sm2_proto::link::{At, EMPTY, RingMemory};

use crate::ring_support::Memory;

/// The other operation. Returns true if it kills the process that makes the access.
type Then<'a> = Box<dyn FnOnce(&Memory) -> bool + 'a>;

/// Ring words that run another operation just before the access with a given index. If that kills
/// the process, this access and all later ones have no effect.
pub(crate) struct Between<'a> {
    memory: &'a Memory,
    left: Cell<u32>,
    dead: Cell<bool>,
    then: RefCell<Option<Then<'a>>>,
}

impl<'a> Between<'a> {
    /// `then` returns true if the process is killed there.
    pub(crate) fn new(
        memory: &'a Memory,
        at: u32,
        then: impl FnOnce(&Memory) -> bool + 'a,
    ) -> Self {
        Self {
            memory,
            left: Cell::new(at),
            dead: Cell::new(false),
            then: RefCell::new(Some(Box::new(then))),
        }
    }

    fn step(&self) -> bool {
        match self.left.get() {
            0 => {
                if let Some(then) = self.then.take() {
                    self.dead.set(then(self.memory));
                }
            }
            left => self.left.set(left - 1),
        }
        !self.dead.get()
    }
}

impl RingMemory for Between<'_> {
    fn load(&self, at: At) -> u64 {
        if self.step() {
            self.memory.load(at)
        } else {
            EMPTY
        }
    }

    fn swap(&self, at: At, bits: u64) -> u64 {
        if self.step() {
            self.memory.swap(at, bits)
        } else {
            EMPTY
        }
    }

    fn take(&self, at: At, bits: u64) -> bool {
        self.step() && self.memory.take(at, bits)
    }

    // Another operation can come before the first word, and in the middle.
    fn write_cell(&self, index: u32, words: &[u64]) {
        let middle = words.len() / 2;
        for (first, part) in [(0, &words[..middle]), (middle, &words[middle..])] {
            if self.step() {
                self.memory.write_cell_from(index, first, part);
            }
        }
    }

    fn read_cell(&self, index: u32, words: &mut [u64]) {
        let (start, rest) = words.split_at_mut(words.len() / 2);
        let middle = start.len();
        for (first, part) in [(0, start), (middle, rest)] {
            if self.step() {
                self.memory.read_cell_from(index, first, part);
            }
        }
    }

    fn fence(&self) {}
}
