//! Harnesses for the words and the layout of a ring, and for a sender and a receiver that obey
//! SPEC.

use alloc::vec::Vec;
use core::cell::Cell;

use super::{
    At, CELL_WORDS, CellMessage, CellView, CellWord, EMPTY, NotAWord, NotTaken, RingLayout,
    RingMemory, RingMessage, RingReceiver, RingSendError, RingSender, SlotHead, TakenMessage, Wake,
    Word,
};
use crate::{
    Instant,
    limits::{CELL_MAX, SLOT_HEAD},
    link::{
        Carrier, Delivery, Fate, MaxLen, Misuse, Payload, SegmentInfo, SlotRange, Status,
        segments::Geometry, wire::Given,
    },
    proofs::{below, one_of},
};

/// Boundary values of sequence numbers.
pub(super) const SEQUENCES: [u64; 6] = [1, 2, 1 << 31, (1 << 32) - 1, 1 << 32, (1 << 40) + 7];

/// Any bits: one group of 16 is arbitrary, and the other groups have boundary values.
fn any_bits() -> u64 {
    let (part, shift): (u16, usize) = (kani::any(), 16 * below(4));
    let others = one_of(&[0, 1 << 30, 1 << 31, u64::MAX, kani::any()]);
    others & !(0xffff << shift) | u64::from(part) << shift
}

/// RNG-INDEX: each word is empty, names a message in a slot, is that of a message in its cell, or is
/// invalid, and no two words name the same message.
//= SM2-RNG-003, SM2-RNG-013 kani
// Shows RNG-INDEX (BoundariesAndSamples), bound: one word of all 64 bits.
#[cfg_attr(kani, kani::proof)]
fn words_are_canonical() {
    let bits = any_bits();
    let word = Word::from_bits(bits);
    let cell = CellWord::from_bits(bits);
    if let Some(cell) = cell {
        assert_eq!(cell.to_bits(), bits);
        assert_eq!(word, Err(NotAWord));
        assert!(usize::from(cell.len) <= CELL_MAX && bits >> 30 & 3 == 1);
        kani::cover!(cell.status != Status::Ok, "a reply in a cell");
    }
    match word {
        Ok(None) => assert_eq!(bits, EMPTY),
        Ok(Some(word)) => {
            assert_eq!(word.to_bits(), bits);
            assert!(word.segment < 32_768);
        }
        Err(NotAWord) => {
            assert!(bits != EMPTY && bits & 1 << 31 == 0);
        }
    }
    kani::cover!(matches!(word, Ok(Some(_))), "a message");
    kani::cover!(cell.is_some(), "a message in its cell");
    kani::cover!(word.is_err() && cell.is_none(), "neither");
}

/// RNG-INDEX: the word of a message names exactly this message; other numbers have no word.
//= SM2-RNG-003 kani
// Shows RNG-INDEX (BoundariesAndSamples), bound: any numbers.
#[cfg_attr(kani, kani::proof)]
fn only_small_numbers_have_words() {
    let segment: u32 = one_of(&[0, 1, 32_767, 32_768, kani::any()]);
    let slot: u32 = one_of(&[0, 65_535, 65_536, kani::any()]);
    let sequence: u64 = kani::any();
    let word = Word::new(segment, slot, sequence);
    assert_eq!(word.is_some(), segment < 32_768 && slot < 65_536);
    if let Some(word) = word {
        assert_eq!(Word::from_bits(word.to_bits()), Ok(Some(word)));
        let named = (u32::from(word.segment), u32::from(word.slot));
        assert_eq!(named, (segment, slot));
        assert_eq!(u64::from(word.sequence), sequence & 0xffff_ffff);
    }
    kani::cover!(word.is_none(), "no word");
}

fn any_at() -> At {
    let index = kani::any();
    one_of(&[
        At::ReceiverParked,
        At::SenderParked,
        At::Forward(index),
        At::Back(index),
    ])
}

/// RNG-INDEX: words and cells do not overlap, and all lie in the file, including those for any
/// sequence number.
//= SM2-RNG-002, SM2-RNG-013 kani
// Shows RNG-INDEX (Samples), bound: any depth and window.
#[cfg_attr(kani, kani::proof)]
fn words_are_inside() {
    let depth: u16 = one_of(&[0, 1, 2, 8, 1_023, 1_024, 1_025, kani::any()]);
    let window =
        u32::from(depth) + one_of(&[0, 1, 2, 1_023, 1_024, 1_025, kani::any::<u8>().into()]);
    let is_legal = (1..=1_024).contains(&depth) && window > u32::from(depth) && window <= 2_048;
    let layout = RingLayout::new(depth, window);
    assert_eq!(layout.is_some(), is_legal);
    kani::cover!(layout.is_none(), "no such ring");
    let Some(layout) = layout else { return };
    let size = layout.size_bytes();
    assert!(size.is_multiple_of(4_096) && size <= 151_552);
    let sequence = one_of(&[0, 1, u64::MAX, kani::any()]);
    let back = layout.offset(At::Back(0)).map(|it| it % 64);
    assert_eq!(back, Some(0), "lines are not shared");
    for at in [layout.forward(sequence), layout.back_word(sequence)] {
        assert!(layout.offset(at).is_some());
    }
    let (one, other) = (any_at(), any_at());
    let inside = |at| match at {
        At::Forward(index) => index < u32::from(depth),
        At::Back(index) => index < window,
        At::ReceiverParked | At::SenderParked => true,
    };
    assert_eq!(layout.offset(one).is_some(), inside(one));
    if let (Some(a), Some(b)) = (layout.offset(one), layout.offset(other)) {
        // The words behind a forward word belong to its cell.
        let cell = match one {
            At::Forward(_) => 8 + 8 * CELL_WORDS as u64,
            _ => 8,
        };
        assert!(a.is_multiple_of(8) && a + cell <= size);
        assert!(one == other || !(a..a + cell).contains(&b));
        assert_eq!(a == b, one == other);
        kani::cover!(
            matches!(one, At::Back(_)) && a > b,
            "a back word and one before it"
        );
    }
}

/// Checks each byte of the head of a slot: which field it belongs to, or that it is reserved.
//= SM2-RNG-004 kani
// Shows RNG-INDEX (Exhaustive), bound: one byte of 64, in each kind of message.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(66))]
fn heads_are_canonical() {
    let mut bytes = [0; SLOT_HEAD];
    let (at, value) = (below(SLOT_HEAD), kani::any());
    bytes[at] = value;
    let carrier = one_of(&[Carrier::Data, Carrier::Request, Carrier::Reply]);
    let head = SlotHead::from_bytes(&bytes, carrier);
    let is_status = carrier == Carrier::Reply && at < 26;
    let expected = match (at, value) {
        (0..24, _) | (_, 0) => Ok(bytes),
        (24, 1..4) if is_status => Ok(bytes),
        _ if is_status => Err(violation!(Malformed, "SM2-RNG-004")),
        _ => Err(violation!(ReservedNotZero, "SM2-RNG-004")),
    };
    assert_eq!(head.map(SlotHead::to_bytes), expected);
    kani::cover!(
        head == Err(violation!(ReservedNotZero, "SM2-RNG-004")),
        "reserved"
    );
    kani::cover!(
        head == Err(violation!(Malformed, "SM2-RNG-004")),
        "no status"
    );
}

/// The memory of a ring with depth 2 and window 4.
#[derive(Default)]
struct Memory {
    forward: [Cell<u64>; 2],
    back: [Cell<u64>; 4],
    parked: [Cell<u64>; 2],
    cells: [Cell<[u64; CELL_WORDS]>; 2],
}

impl Memory {
    fn word(&self, at: At) -> &Cell<u64> {
        match at {
            At::ReceiverParked => &self.parked[0],
            At::SenderParked => &self.parked[1],
            At::Forward(index) => &self.forward[index as usize],
            At::Back(index) => &self.back[index as usize],
        }
    }
}

impl RingMemory for Memory {
    fn load(&self, at: At) -> u64 {
        self.word(at).get()
    }

    fn swap(&self, at: At, bits: u64) -> u64 {
        self.word(at).replace(bits)
    }

    fn take(&self, at: At, bits: u64) -> bool {
        let is_there = self.word(at).get() == bits;
        if is_there {
            self.word(at).set(EMPTY);
        }
        is_there
    }

    fn write_cell(&self, index: u32, words: &[u64]) {
        let cell = &self.cells[index as usize];
        let mut now = cell.get();
        now[..words.len()].copy_from_slice(words);
        cell.set(now);
    }

    fn read_cell(&self, index: u32, words: &mut [u64]) {
        words.copy_from_slice(&self.cells[index as usize].get()[..words.len()]);
    }

    fn fence(&self) {}
}

const SEGMENT: SegmentInfo = SegmentInfo {
    id: 3,
    stride: 4_096,
    slots: 8,
};

/// Two ends that obey SPEC, and the messages between them. Each slot holds the message with the
/// number of the slot; a message in a cell has its number as its time and in its payload.
struct Ends {
    reliable: bool,
    memory: Memory,
    sender: RingSender,
    receiver: RingReceiver,
    /// How each message in a slot was settled, by number.
    fates: [Option<Fate>; 8],
    /// Whether each message is in a cell, by number.
    in_cell: [bool; 8],
    sent: u64,
    /// The number of the last message that was taken.
    taken: u64,
    takes: u64,
    held: Vec<u64>,
}

impl Ends {
    fn new(reliable: bool) -> Self {
        let layout = RingLayout::new(2, 4).expect("a legal layout");
        let mut sender = RingSender::new(layout, Carrier::Data, reliable, false);
        assert_eq!(sender.segments.attach(&SEGMENT), Ok(()));
        while sender.segments.poll().is_some() {}
        Self {
            reliable,
            memory: Memory::default(),
            sender,
            receiver: RingReceiver::new(
                layout,
                Carrier::Data,
                reliable,
                false,
                2,
                MaxLen::GREATEST,
            ),
            fates: [None; 8],
            in_cell: [false; 8],
            sent: 0,
            taken: 0,
            takes: 0,
            held: Vec::new(),
        }
    }

    /// The oldest message that was not taken and not displaced.
    fn oldest(&self) -> u64 {
        (self.taken + 1).max(self.sent.saturating_sub(1))
    }

    fn send(&mut self, in_cell: bool) {
        let number = self.sent + 1;
        let bytes = [number as u8];
        let short = CellMessage {
            id: number,
            time: Instant(number),
            status: Status::Ok,
            bytes: &bytes,
        };
        let message = RingMessage {
            key: number,
            id: number,
            len: 0,
            segment: SEGMENT,
            slot: number as u32,
        };
        let mut settled = |key, fate| settle(&mut self.fates, key, fate);
        let sent = match in_cell {
            false => self.sender.send(&self.memory, &message, &mut settled),
            true => (self.sender).send_in_cell(&self.memory, &short, &mut settled),
        };
        match sent {
            Ok(wake) => {
                assert_eq!(wake, Wake::NotNeeded);
                self.sent = number;
                self.in_cell[number as usize] = in_cell;
            }
            Err(why) => {
                assert!(self.reliable && why == RingSendError::Misuse(Misuse::NoRoom));
                assert!(self.sent - self.taken == 2 || self.sender.in_flight() == 4);
            }
        }
    }

    fn take(&mut self) {
        let geometry = Geometry::new(SEGMENT.stride, SEGMENT.slots);
        let head = |slot: SlotRange| {
            let head = SlotHead {
                id: slot.offset / 4_096,
                time: Instant(0),
                len: 0,
                status: Status::Ok,
            };
            Some(head.to_bytes())
        };
        let oldest = self.oldest();
        match take(&mut self.receiver, &self.memory, geometry, head) {
            Ok(Some(delivery)) => {
                assert_eq!((delivery.sequence, delivery.id), (oldest, oldest));
                assert_eq!(delivery.lost, oldest - self.taken - 1);
                self.taken = oldest;
                self.takes += 1;
                match delivery.payload {
                    Payload::Cell(bytes) => {
                        assert!(self.in_cell[oldest as usize]);
                        assert_eq!(
                            (&*bytes, delivery.time),
                            (&[oldest as u8][..], Instant(oldest))
                        );
                    }
                    Payload::Pooled { segment: 3, .. } => {
                        assert!(!self.in_cell[oldest as usize]);
                        self.held.push(oldest);
                    }
                    other => panic!("{other:?}"),
                }
            }
            Ok(None) => assert_eq!(self.taken, self.sent),
            Err(why) => {
                assert!(matches!(why, NotTaken::TooManyBorrowed(_)) && self.held.len() == 2);
            }
        }
    }

    fn release(&mut self) {
        if let Some(sequence) = self.held.pop() {
            let released = self
                .receiver
                .release_all(&self.memory, [sequence], Given::Consumed);
            assert_eq!(released, Ok(Wake::NotNeeded));
        }
    }

    fn harvest(&mut self) {
        let mut settled = |key, fate| settle(&mut self.fates, key, fate);
        assert_eq!(self.sender.harvest(&self.memory, &mut settled), Ok(()));
        // All that the receiver took from cells is settled now, and all that it gave back.
        assert_eq!(self.sender.in_flight(), self.held.len() + self.in_ring());
    }

    fn in_ring(&self) -> usize {
        let words = self.memory.forward.iter();
        words.filter(|it| it.get() != EMPTY).count()
    }

    fn check(&self) {
        self.sender.invariants();
        self.receiver.invariants();
        assert_eq!(self.in_ring() as u64, self.sent + 1 - self.oldest());
        let lost = self.sent - self.takes - self.in_ring() as u64;
        assert_eq!(self.sender.counters().discarded, lost);
        assert!(lost == 0 || !self.reliable);
        for number in 1..self.oldest() {
            let fate = self.fates[number as usize];
            let may_be_discarded = !self.reliable && !self.held.contains(&number);
            assert!(fate != Some(Fate::Discarded) || may_be_discarded);
            assert!(fate.is_none() || !self.in_cell[number as usize]);
        }
    }
}

/// Takes the next message, as [`Link::take`](crate::link::Link::take) does.
pub(super) fn take(
    receiver: &mut RingReceiver,
    words: &impl RingMemory,
    geometry: Option<Geometry>,
    head: impl Fn(SlotRange) -> Option<[u8; SLOT_HEAD]>,
) -> Result<Option<Delivery>, NotTaken> {
    let mut cell = [0; CELL_WORDS];
    match receiver.take_word(words, &mut cell, |_| geometry, |_| {})? {
        Some(TakenMessage::Slot(taken)) => receiver.receive(taken, head(taken.slot)).map(Some),
        Some(TakenMessage::Cell(word)) => {
            let taken = receiver.receive_cell(word, &cell)?;
            Ok(Some(taken.map_cell(CellView::to_bytes)))
        }
        None => Ok(None),
    }
}

/// Records how a message was settled.
fn settle(fates: &mut [Option<Fate>; 8], key: u64, fate: Fate) {
    let before = fates[key as usize].replace(fate);
    assert_eq!(before, None, "settled once");
}

/// RNG-FIFO: seven steps of two ends that obey SPEC. Messages are taken in the order in which they
/// were sent. On a reliable link, all messages are taken. Otherwise the last two stay in the ring,
/// and a message is discarded exactly if it was not taken and is not in the ring.
//= SM2-RNG-005, SM2-RNG-006, SM2-RNG-007, SM2-RNG-008, SM2-QOS-001 kani
// Shows RNG-FIFO (Exhaustive), bound: depth 2.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(10))]
fn the_last_two_are_there() {
    let mut ends = Ends::new(kani::any());
    for _ in 0..7 {
        match below(4) {
            0 => ends.send(false),
            1 => ends.take(),
            2 => ends.release(),
            _ => ends.harvest(),
        }
        ends.check();
    }
    kani::cover!(ends.fates.contains(&Some(Fate::Discarded)), "displaced");
    kani::cover!(ends.reliable && ends.taken == 3, "three reliable ones");
}

/// RNG-FIFO: the same for six steps with messages in slots and in cells.
//= SM2-RNG-005, SM2-RNG-007, SM2-RNG-008, SM2-RNG-013, SM2-QOS-001 kani
// Shows RNG-FIFO (Exhaustive), bound: depth 2.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(17))]
fn the_last_two_are_there_in_slots_or_cells() {
    let mut ends = Ends::new(kani::any());
    for _ in 0..6 {
        match below(5) {
            0 => ends.send(false),
            1 => ends.send(true),
            2 => ends.take(),
            3 => ends.release(),
            _ => ends.harvest(),
        }
        ends.check();
    }
    let cells = ends.in_cell.iter().filter(|it| **it).count();
    kani::cover!(
        ends.sender.counters().discarded > 0 && cells == 3 && ends.sent == 3,
        "a cell, displaced by a cell"
    );
    kani::cover!(ends.fates.contains(&Some(Fate::Discarded)), "displaced");
    kani::cover!(ends.reliable && ends.taken == 3, "three reliable ones");
}

#[cfg(test)]
kani::explored! {
    words_are_canonical: 4,
    only_small_numbers_have_words: 1,
    words_are_inside: 2,
    heads_are_canonical: 2,
    the_last_two_are_there: 2,
    the_last_two_are_there_in_slots_or_cells: 3,
}
