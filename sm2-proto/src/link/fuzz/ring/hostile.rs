//! The memory of a ring whose words answer as fuzz input says.

use alloc::collections::BTreeMap;
use core::cell::{Cell, RefCell};

use crate::{
    fuzz::Script,
    link::{At, CELL_WORDS, EMPTY, RingLayout, RingMemory},
};

/// A ring memory that can answer anything.
pub(super) struct Hostile<'a> {
    pub(super) layout: RingLayout,
    /// The words by offset.
    memory: RefCell<BTreeMap<u64, u64>>,
    script: RefCell<Script<'a>>,
    accesses: Cell<u64>,
    /// Whether each `take` fails, unless fuzz input makes the word lie about that, too.
    stubborn: bool,
}

impl<'a> Hostile<'a> {
    pub(super) fn new(layout: RingLayout, answers: &'a [u8], stubborn: bool) -> Self {
        Self {
            layout,
            memory: RefCell::default(),
            script: RefCell::new(Script::new(answers)),
            accesses: Cell::new(0),
            stubborn,
        }
    }

    /// The answers that were not given yet.
    pub(super) fn answers(&self) -> Script<'a> {
        self.script.borrow().clone()
    }

    pub(super) fn depth(&self) -> u64 {
        u64::from(self.layout.depth())
    }

    pub(super) fn window(&self) -> u64 {
        u64::from(self.layout.window())
    }

    /// Checks how many accesses a call made: never more than the layout allows, whatever the words
    /// contain.
    pub(super) fn check_accesses(&self, most: u64) {
        let accesses = self.accesses.take();
        assert!(accesses <= most, "{accesses} accesses, {most} at most");
    }

    fn offset(&self, at: At) -> u64 {
        self.layout.offset(at).expect("a word of the ring")
    }

    pub(super) fn set(&self, at: At, bits: u64) -> u64 {
        let offset = self.offset(at);
        self.memory
            .borrow_mut()
            .insert(offset, bits)
            .unwrap_or(EMPTY)
    }

    /// The offset of the first word of a cell behind its forward word.
    fn cell(&self, index: u32, words: usize) -> u64 {
        assert!(words <= CELL_WORDS, "{words} words of a cell");
        self.offset(At::Forward(index)) + 8
    }

    /// Writes the first words of a cell.
    pub(super) fn set_cell(&self, index: u32, words: &[u64]) {
        let first = self.cell(index, words.len());
        let offsets = (first..).step_by(8);
        let mut memory = self.memory.borrow_mut();
        memory.extend(offsets.zip(words.iter().copied()));
    }

    fn count(&self) {
        self.accesses.set(self.accesses.get() + 1);
    }

    /// Answers with the true value, or with a value from fuzz input.
    fn answer(&self, right: u64) -> u64 {
        self.count();
        self.lie(right)
    }

    fn lie(&self, right: u64) -> u64 {
        let mut script = self.script.borrow_mut();
        let mut lie = || {
            let kind = script.byte()?;
            Some(match kind {
                0xff => EMPTY,
                0xfe => u64::from(script.byte()?) << (script.byte()? % 64),
                0xfd => right ^ 1 << (script.byte()? % 64),
                // The word of an earlier or later message.
                0xfc => right.wrapping_add(u64::from(script.byte()? % 32) << 32),
                0xfb => right.wrapping_sub(u64::from(script.byte()? % 32) << 32),
                _ => right,
            })
        };
        lie().unwrap_or(right)
    }
}

impl RingMemory for Hostile<'_> {
    fn load(&self, at: At) -> u64 {
        let offset = self.offset(at);
        let right = self.memory.borrow().get(&offset).copied();
        self.answer(right.unwrap_or(EMPTY))
    }

    fn swap(&self, at: At, bits: u64) -> u64 {
        let right = self.set(at, bits);
        self.answer(right)
    }

    fn take(&self, at: At, bits: u64) -> bool {
        let offset = self.offset(at);
        let there = self.memory.borrow().get(&offset).copied();
        let is_there = !self.stubborn && there.unwrap_or(EMPTY) == bits;
        let answer = self.answer(u64::from(is_there)) == 1;
        if answer {
            self.set(at, EMPTY);
        }
        answer
    }

    fn write_cell(&self, index: u32, words: &[u64]) {
        self.count();
        self.set_cell(index, words);
    }

    fn read_cell(&self, index: u32, words: &mut [u64]) {
        self.count();
        let first = self.cell(index, words.len());
        for (offset, word) in (first..).step_by(8).zip(words) {
            let right = self.memory.borrow().get(&offset).copied();
            *word = self.lie(right.unwrap_or(0));
        }
    }

    fn fence(&self) {}
}
