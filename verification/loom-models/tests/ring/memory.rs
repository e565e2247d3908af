//! The memory that both ends of a link map: the words of a ring, and a segment of slots.

use loom::cell::UnsafeCell;
use sm2_proto::limits::SLOT_HEAD;
use sm2_proto::link::{At, RingLayout, SegmentInfo};

use crate::sync::AtomicU64;

pub(crate) struct Memory {
    pub(crate) layout: RingLayout,
    /// The words in the order of the layout, without gaps.
    words: Vec<AtomicU64>,
    /// The words behind each forward word.
    pub(crate) cells: Vec<CellPlace>,
    pub(crate) slots: Vec<Slot>,
}

impl Memory {
    pub(crate) fn new(layout: RingLayout, slots: u32) -> Self {
        let count = 2 + usize::from(layout.depth()) + layout.window() as usize;
        Self {
            layout,
            words: (0..count).map(|_| AtomicU64::new(0)).collect(),
            cells: (0..layout.depth()).map(|_| CellPlace::new()).collect(),
            slots: (0..slots).map(|_| Slot::default()).collect(),
        }
    }

    pub(crate) fn word(&self, at: At) -> &AtomicU64 {
        assert!(self.layout.offset(at).is_some(), "a word of the ring");
        let index = match at {
            At::ReceiverParked => 0,
            At::SenderParked => 1,
            At::Forward(index) => 2 + index,
            At::Back(index) => 2 + u32::from(self.layout.depth()) + index,
        };
        &self.words[index as usize]
    }

    pub(crate) fn segment(&self) -> SegmentInfo {
        SegmentInfo {
            id: 0,
            stride: 4096,
            slots: self.slots.len() as u32,
        }
    }
}

/// As many words of a cell as a message of eight bytes takes.
pub(crate) struct CellPlace {
    pub(crate) words: [AtomicU64; 3],
    /// The id of the last message that the receiver has copied. It stores the id in the program order of its copies,
    /// and relaxed like these. So a sender whose writes are ordered behind the copies of a message loads its id.
    pub(crate) copied: AtomicU64,
    /// Accessed before each load of the forward word by one end, and before each change of that word by the other one:
    /// the first by loads of the sender, the second by those of the receiver. loom reorders an access with the last one
    /// of the same place only. An end that loads a word before it changes the word would hide the other end's load.
    pub(crate) loads: [AtomicU64; 2],
}

impl CellPlace {
    fn new() -> Self {
        Self {
            words: [0; 3].map(AtomicU64::new),
            copied: AtomicU64::new(0),
            loads: [0; 2].map(AtomicU64::new),
        }
    }
}

/// A payload of eight bytes, and the head of the message. loom fails an execution where two
/// threads access one at the same time, or could.
#[derive(Default)]
pub(crate) struct Slot {
    payload: UnsafeCell<u64>,
    head: UnsafeCell<Option<[u8; SLOT_HEAD]>>,
}

// SAFETY: each access goes through loom, which panics before any access that is not ordered with
// every conflicting one.
unsafe impl Sync for Slot {}

impl Slot {
    pub(crate) fn write(&self, payload: u64, head: [u8; SLOT_HEAD]) {
        // SAFETY: see `Sync`; the pointer is that of the cell.
        self.payload.with_mut(|it| unsafe { *it = payload });
        // SAFETY: as above.
        self.head.with_mut(|it| unsafe { *it = Some(head) });
    }

    pub(crate) fn payload(&self) -> u64 {
        // SAFETY: see `Sync`; the pointer is that of the cell.
        self.payload.with(|it| unsafe { *it })
    }

    pub(crate) fn head(&self) -> Option<[u8; SLOT_HEAD]> {
        // SAFETY: see `Sync`; the pointer is that of the cell.
        self.head.with(|it| unsafe { *it })
    }
}
