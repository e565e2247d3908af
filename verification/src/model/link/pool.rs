//! The memory that an end sends from, as its readers see it.

use std::collections::BTreeMap;

use sm2_proto::link::SegmentInfo;

use super::LinkScope;

/// One slot. A retired segment's number is reused with another stride.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Slot {
    pub(super) segment: u32,
    pub(super) generation: u8,
    pub(super) slot: u32,
}

/// The content of a slot. A slot without an entry is free, and may have any content.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Cell {
    /// A message with this id that is not settled.
    InUse(u64),
    /// A message with this id, for ever: the link ended while it was not settled.
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

    /// Frees the slot, and overwrites it.
    pub(super) fn give_back(&mut self, slot: Slot) {
        self.cells.remove(&slot);
    }

    /// The slot is never written again.
    pub(super) fn abandon(&mut self, slot: Slot) {
        if let Some(Cell::InUse(id)) = self.cells.get(&slot).copied() {
            self.cells.insert(slot, Cell::Abandoned(id));
        }
    }

    /// True if no slot holds a message that is not settled.
    pub(super) fn all_back(&self) -> bool {
        let in_use = |cell: &Cell| matches!(cell, Cell::InUse(_));
        !self.cells.values().any(in_use)
    }

    /// True if the segment can be retired.
    pub(super) fn is_idle(&self, segment: u32) -> bool {
        !self.cells.keys().any(|slot| slot.segment == segment)
    }

    /// From now on the segment's number stands for a new segment.
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
    /// Returns the slot of a mapped segment that begins at `offset`, if there is one.
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

/// Segments that reuse a number differ in their stride.
const fn stride(generation: u8) -> u64 {
    4096 << generation
}
