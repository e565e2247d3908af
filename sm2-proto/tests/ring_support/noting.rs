//! Ring words that note each access to them.

use std::cell::RefCell;

use sm2_proto::link::{At, RingMemory};

use crate::ring_support::Memory;

/// An access to a ring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Access {
    Load(At),
    Swap(At, u64),
    Take(At, u64),
    /// This many words behind the forward word with this index were written.
    Write(u32, usize),
    /// This many words behind the forward word with this index were read.
    Read(u32, usize),
    Fence,
}

/// Ring words that note each access to them.
pub(crate) struct Noting<'a> {
    memory: &'a Memory,
    accesses: RefCell<Vec<Access>>,
}

impl<'a> Noting<'a> {
    pub(crate) fn new(memory: &'a Memory) -> Self {
        Self {
            memory,
            accesses: RefCell::default(),
        }
    }

    pub(crate) fn accesses(&self) -> Vec<Access> {
        self.accesses.take()
    }

    fn note(&self, access: Access) {
        self.accesses.borrow_mut().push(access);
    }
}

impl RingMemory for Noting<'_> {
    fn load(&self, at: At) -> u64 {
        self.note(Access::Load(at));
        self.memory.load(at)
    }

    fn swap(&self, at: At, bits: u64) -> u64 {
        self.note(Access::Swap(at, bits));
        self.memory.swap(at, bits)
    }

    fn take(&self, at: At, bits: u64) -> bool {
        self.note(Access::Take(at, bits));
        self.memory.take(at, bits)
    }

    fn write_cell(&self, index: u32, words: &[u64]) {
        self.note(Access::Write(index, words.len()));
        self.memory.write_cell(index, words);
    }

    fn read_cell(&self, index: u32, words: &mut [u64]) {
        self.note(Access::Read(index, words.len()));
        self.memory.read_cell(index, words);
    }

    fn fence(&self) {
        self.note(Access::Fence);
        self.memory.fence();
    }
}
