//! Both ends of a ring (SPEC section 8.5), operated by hand and not bound to SPEC.
//!
//! Words and heads are written from SPEC alone. The mapping of `sm2-io` is used for its atomic
//! operations; its own tests check that each word is at the right offset.

use std::os::fd::{AsFd, OwnedFd};

use sm2_io::{InspectedFd, Ring, Segment, Slot};
use sm2_proto::{
    Seals,
    link::{At, RingLayout, RingMemory},
};

use crate::{
    link::{Open, attach, kind, ring, role},
    memory,
    raw::RawLink,
};

/// The size of every slot here.
pub const PAGE: u64 = 4096;

/// The word that names a message.
#[must_use]
pub const fn word(segment: u64, slot: u64, sequence: u64) -> u64 {
    (sequence & 0xffff_ffff) << 32 | 1 << 31 | segment << 16 | slot
}

/// The word that names a message in its cell.
#[must_use]
pub const fn cell_word(len: u64, status: u64, sequence: u64) -> u64 {
    (sequence & 0xffff_ffff) << 32 | 1 << 30 | status << 8 | len
}

/// Whether a word names a message in a slot.
#[must_use]
pub const fn is_in_slot(bits: u64) -> bool {
    bits & 1 << 31 != 0
}

/// The words of a cell behind its forward word; `time` is 0.
#[must_use]
pub fn cell(id: u64, payload: &[u8]) -> Vec<u64> {
    let word = |bytes: &[u8]| {
        let mut word = [0; 8];
        word[..bytes.len()].copy_from_slice(bytes);
        u64::from_le_bytes(word)
    };
    [id, 0]
        .into_iter()
        .chain(payload.chunks(8).map(word))
        .collect()
}

/// The head at the end of a slot; `time` is 0.
#[must_use]
pub fn head(id: u64, len: u64) -> [u8; 64] {
    let mut bytes = [0; 64];
    bytes[..8].copy_from_slice(&id.to_le_bytes());
    bytes[16..24].copy_from_slice(&len.to_le_bytes());
    bytes
}

/// The size of a ring's file.
#[must_use]
pub fn size(depth: u16, window: u32) -> u64 {
    let back = 128 + 128 * u64::from(depth);
    (back + 8 * u64::from(window)).next_multiple_of(PAGE)
}

fn map(file: &OwnedFd, layout: RingLayout) -> Ring {
    let file = file.try_clone().expect("a descriptor");
    let file = InspectedFd::new(file)
        .unwrap()
        .into_ring()
        .expect("a ring's file");
    Ring::map(&file, layout).expect("a mapping")
}

/// A publisher's end that has the receiver's ring, and segment 1 with slots of a page.
#[derive(Debug)]
pub struct RawSender {
    /// The receiver's ring.
    pub ring: Ring,
    /// The receiver's depth.
    pub depth: u16,
    /// The receiver's window.
    pub window: u32,
    slots: Vec<Slot>,
}

impl RawSender {
    /// Reads RING, which must be the receiver's first frame after OPEN, and attaches a segment.
    #[must_use]
    #[track_caller]
    pub fn new(link: &RawLink, slots: u32) -> Self {
        let frame = link.end.expect();
        assert_eq!(frame.bytes[0], kind::RING, "RING comes first: {frame:?}");
        assert_eq!((frame.bytes.len(), frame.fds.len()), (16, 1), "RING");
        let depth = u16::from_le_bytes([frame.bytes[2], frame.bytes[3]]);
        let window = u32::from_le_bytes(frame.bytes[4..8].try_into().expect("4 bytes"));
        let facts = sm2_io::memfd::facts(frame.fds[0].as_fd()).expect("facts");
        assert!(facts.regular && facts.seals.contains(Seals::RING));
        assert_eq!(facts.size_bytes, size(depth, window));
        let layout = RingLayout::new(depth, window).expect("a legal layout");
        let ring = map(&frame.fds[0], layout);
        let (fd, memory) = Segment::create(PAGE, slots).expect("a segment").split();
        link.end.send_fds(attach(1, PAGE, slots), &[fd.as_fd()]);
        Self {
            ring,
            depth,
            window,
            slots: memory.into_iter().collect(),
        }
    }

    /// Sends OPEN, reads the other side's, and continues as [`new`](Self::new).
    #[must_use]
    #[track_caller]
    pub fn open(link: &RawLink, slots: u32) -> Self {
        let open = Open::new(role::SENDER, link.id, 0).with_ring();
        link.end.send(open.bytes());
        assert_eq!(link.end.expect().bytes[0], kind::OPEN, "OPEN comes first");
        Self::new(link, slots)
    }

    /// Writes a payload and a head into a slot.
    pub fn fill(&mut self, slot: usize, payload: &[u8], head: [u8; 64]) {
        let page = self.slots[slot].bytes_mut(PAGE as usize);
        page[..payload.len()].copy_from_slice(payload);
        page[PAGE as usize - 64..].copy_from_slice(&head);
    }

    /// The position of the word of this message.
    #[must_use]
    pub fn at(&self, sequence: u64) -> At {
        At::Forward((sequence % u64::from(self.depth)) as u32)
    }

    /// Puts a word at the position of this message. Returns the previous word.
    pub fn put(&self, sequence: u64, bits: u64) -> u64 {
        self.ring.swap(self.at(sequence), bits)
    }

    /// Sends a correct message in this slot. Returns the word that it displaced.
    pub fn send(&mut self, sequence: u64, slot: usize, payload: &[u8]) -> u64 {
        self.fill(slot, payload, head(sequence, payload.len() as u64));
        self.put(sequence, word(1, slot as u64, sequence))
    }

    /// Writes the cell of this message.
    pub fn fill_cell(&self, sequence: u64, id: u64, payload: &[u8]) {
        let index = (sequence % u64::from(self.depth)) as u32;
        self.ring.write_cell(index, &cell(id, payload));
    }

    /// Sends a correct message in its cell, which is empty.
    pub fn send_in_cell(&self, sequence: u64, payload: &[u8]) {
        self.fill_cell(sequence, sequence, payload);
        let word = cell_word(payload.len() as u64, 0, sequence);
        assert_eq!(self.put(sequence, word), 0, "message {sequence}");
    }

    /// Takes the `n`th back word, counted from 0.
    pub fn harvest(&self, n: u64) -> u64 {
        let at = At::Back((n % u64::from(self.window)) as u32);
        self.ring.swap(at, 0)
    }

    /// Sends a doorbell if the receiver is parked.
    pub fn bell(&self, link: &RawLink) {
        self.ring.fence();
        if self.ring.swap(At::ReceiverParked, 0) == 1 {
            link.end.send(crate::link::doorbell());
        }
    }
}

/// A subscriber's end that has made a ring.
#[derive(Debug)]
pub struct RawReceiver {
    /// The ring.
    pub ring: Ring,
    /// Its file.
    pub file: OwnedFd,
    depth: u16,
    window: u32,
}

impl RawReceiver {
    /// A ring that the other side has not received yet.
    #[must_use]
    pub fn new(depth: u16, window: u32) -> Self {
        let layout = RingLayout::new(depth, window).expect("a legal layout");
        let file = memory::memfd(size(depth, window), Seals::RING);
        let ring = map(&file, layout);
        Self {
            ring,
            file,
            depth,
            window,
        }
    }

    /// Sends RING.
    pub fn offer(&self, link: &RawLink) {
        let frame = ring(self.depth, self.window);
        link.end.send_fds(frame, &[self.file.as_fd()]);
    }

    /// Sends OPEN, reads the other side's, and sends RING.
    #[must_use]
    #[track_caller]
    pub fn open(link: &RawLink, depth: u16, window: u32) -> Self {
        let open = Open::new(role::RECEIVER, link.id, window).with_ring();
        link.end.send(open.bytes());
        assert_eq!(link.end.expect().bytes[0], kind::OPEN, "OPEN comes first");
        let receiver = Self::new(depth, window);
        receiver.offer(link);
        receiver
    }

    /// Takes this message out of the ring, if it is there. Returns its word.
    #[must_use]
    pub fn take(&self, sequence: u64) -> Option<u64> {
        let at = At::Forward((sequence % u64::from(self.depth)) as u32);
        let bits = self.ring.load(at);
        (bits >> 32 == sequence & 0xffff_ffff && bits != 0 && self.ring.take(at, bits))
            .then_some(bits)
    }

    /// The id and the payload of the message that a word has named in its cell.
    #[must_use]
    pub fn in_cell(&self, bits: u64) -> (u64, Vec<u8>) {
        assert_eq!(bits >> 30 & 3, 1, "a message in its cell: {bits:#x}");
        let mut words = [0; 15];
        let index = (bits >> 32) % u64::from(self.depth);
        self.ring.read_cell(index as u32, &mut words);
        let payload = words[2..].iter().flat_map(|it| it.to_le_bytes());
        (words[0], payload.take((bits & 0xff) as usize).collect())
    }

    /// Puts these bits at the `n`th back word, counted from 0.
    pub fn give(&self, n: u64, bits: u64) -> u64 {
        self.ring
            .swap(At::Back((n % u64::from(self.window)) as u32), bits)
    }
}
