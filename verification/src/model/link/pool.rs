//! The memory that an end sends from, and what its readers find there.

use std::collections::BTreeMap;

use sm2_proto::link::SegmentInfo;

use super::LinkScope;

/// One slot. A segment that was retired comes back under its number, in another form.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Slot {
    pub(super) segment: u32,
    pub(super) generation: u8,
    pub(super) slot: u32,
}

/// The content of a slot. A slot without an entry is free, and may have any content.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Cell {
    /// The message of this id, which is not settled.
    InUse(u64),
    /// The same, for ever: the link ended with it.
    Abandoned(u64),
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Pool {
    cells: BTreeMap<Slot, Cell>,
    generations: BTreeMap<u32, u8>,
}

impl Pool {
    /// The next free slot.
    pub(super) fn free(&self, scope: &LinkScope) -> Option<Slot> {
        let slots = |segment| (0..scope.slots).map(move |slot| (segment, slot));
        let mut all = (0..scope.segments).flat_map(slots);
        all.find_map(|(segment, slot)| {
            let generation = self.generation(segment);
            let slot = Slot {
                segment,
                generation,
                slot,
            };
            (!self.cells.contains_key(&slot)).then_some(slot)
        })
    }

    /// The application writes a message.
    pub(super) fn write(&mut self, slot: Slot, id: u64) {
        self.cells.insert(slot, Cell::InUse(id));
    }

    /// The content that a reader finds.
    pub(super) fn read(&self, slot: Slot) -> Option<u64> {
        match self.cells.get(&slot)? {
            Cell::InUse(id) | Cell::Abandoned(id) => Some(*id),
        }
    }

    /// The slot may be written again, and is.
    pub(super) fn give_back(&mut self, slot: Slot) {
        self.cells.remove(&slot);
    }

    /// The slot is never written again.
    pub(super) fn abandon(&mut self, slot: Slot) {
        if let Some(Cell::InUse(id)) = self.cells.get(&slot).copied() {
            self.cells.insert(slot, Cell::Abandoned(id));
        }
    }

    /// Whether no message that is not settled has a slot.
    pub(super) fn all_back(&self) -> bool {
        let in_use = |cell: &Cell| matches!(cell, Cell::InUse(_));
        !self.cells.values().any(in_use)
    }

    /// Whether the segment can be given up.
    pub(super) fn is_idle(&self, segment: u32) -> bool {
        !self.cells.keys().any(|slot| slot.segment == segment)
    }

    /// The segment's number stands for another one from now on.
    pub(super) fn retire(&mut self, segment: u32) {
        *self.generations.entry(segment).or_default() += 1;
    }

    /// The segment that has this number now.
    pub(super) fn info(&self, scope: &LinkScope, segment: u32) -> SegmentInfo {
        SegmentInfo {
            id: segment,
            stride: stride(self.generation(segment)),
            slots: scope.slots,
        }
    }

    fn generation(&self, segment: u32) -> u8 {
        self.generations.get(&segment).copied().unwrap_or_default()
    }
}

impl Slot {
    /// The slot of a mapped segment that begins at `offset`, if one does.
    pub(super) fn at(info: &SegmentInfo, offset: u64) -> Option<Self> {
        let slot = u32::try_from(offset / info.stride).ok()?;
        let generation = (0..8).find(|it| stride(*it) == info.stride)?;
        let inside = offset.is_multiple_of(info.stride) && slot < info.slots;
        inside.then_some(Self {
            segment: info.id,
            generation,
            slot,
        })
    }
}

/// Segments of one number differ in this.
const fn stride(generation: u8) -> u64 {
    4096 << generation
}
