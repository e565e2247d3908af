//! The receiving end's view of messages on the ring lane: SPEC section 8.5.

// Shows RNG-FIFO, RNG-HOSTILE (test).

use std::cell::{Cell, RefCell};

use crate::link_support::{NOW, pooled};
use crate::ring_support::{Memory, RECEIVER, Rig, SENDER, head, segment, word};
use sm2_proto::{
    Farewell, Instant, Machine, ViolationKind,
    limits::SLOT_HEAD,
    link::{
        At, Delivery, EMPTY, End, Error, FrameKind, Input, LentRing, LinkMemory, Misuse,
        NoDelivery, Output, Payload, RingMemory, SegmentInfo, SlotRange, Status, TooManyBorrowed,
        wire::Frame,
    },
    violation,
};

//= SM2-RNG-004, SM2-RNG-007, SM2-PAY-003, SM2-PAY-006 test
#[test]
fn a_delivery_says_what_the_head_says() {
    let mut rig = Rig::open(false, 2, 1);
    assert!(!rig.ends[RECEIVER].may_take(&rig.words));
    assert_eq!(rig.ends[RECEIVER].untaken(&rig.words), 0);
    assert_eq!(rig.take(), Ok(None));
    let _ = rig.send(4, 3).unwrap();
    assert!(rig.ends[RECEIVER].may_take(&rig.words));
    assert_eq!(rig.ends[RECEIVER].untaken(&rig.words), 1);
    let expected = Delivery {
        sequence: 1,
        id: 4,
        time: Instant(104),
        status: Status::Ok,
        lost: 0,
        len: 4,
        payload: Payload::Pooled {
            segment: 0,
            offset: 3 * 4096,
        },
    };
    assert_eq!(rig.take(), Ok(Some(expected)));
    assert_eq!(rig.words.forward(), [EMPTY, EMPTY]);
    // The whole head of the slot is copied, once.
    let _ = rig.send(5, 2).unwrap();
    let _ = rig.release(1).unwrap();
    let calls = Cell::new(0);
    let second = SlotRange {
        segment: 0,
        offset: 2 * 4096,
        stride: 4096,
    };
    let copy = |slot| {
        assert_eq!(slot, second);
        calls.set(calls.get() + 1);
        Some(head(5).to_bytes())
    };
    let taken = rig.ends[RECEIVER].take(&LentRing::new(&rig.words, copy));
    assert!(taken.unwrap().is_some() && calls.get() == 1);
    // If there is nothing to take, no head is copied.
    let taken = rig.ends[RECEIVER].take(&LentRing::new(&rig.words, |_| panic!("nothing is there")));
    assert_eq!(taken, Ok(None));
}

/// Memory that notes what is prefetched, and whether the word was in the ring at that time.
struct Prefetching<'a> {
    memory: &'a Memory,
    prefetched: RefCell<Vec<(SlotRange, bool)>>,
}

impl LinkMemory for Prefetching<'_> {
    type Ring = Memory;

    const PREFETCHES: bool = true;

    fn outgoing(&self) -> Option<&Memory> {
        None
    }

    fn incoming(&self) -> Option<&Memory> {
        Some(self.memory)
    }

    fn slot_head(&self, _: SlotRange) -> Option<[u8; SLOT_HEAD]> {
        Some(head(1).to_bytes())
    }

    fn prefetch(&self, slot: SlotRange) {
        let is_there = self.memory.forward().iter().any(|word| *word != EMPTY);
        self.prefetched.borrow_mut().push((slot, is_there));
    }
}

//= SM2-RNG-007 test
#[test]
fn a_slot_is_prefetched_before_its_word_is_taken() {
    let mut rig = Rig::open(false, 2, 2);
    let _ = rig.send(1, 3).unwrap();
    let memory = Prefetching {
        memory: &rig.words,
        prefetched: RefCell::default(),
    };
    assert_eq!(rig.ends[RECEIVER].take(&memory).unwrap().unwrap().id, 1);
    assert_eq!(rig.ends[RECEIVER].take(&memory), Ok(None));
    let place = SlotRange {
        segment: 0,
        offset: 3 * 4096,
        stride: 4096,
    };
    assert_eq!(memory.prefetched.take(), [(place, true)]);
    // Nothing is prefetched for a slot that does not exist.
    rig.words.swap(At::Forward(0), word(0, 60_000, 2));
    let bad_slot = rig.ends[RECEIVER].take(&memory);
    assert!(matches!(bad_slot, Err(NoDelivery::Ended(_))));
    assert_eq!(memory.prefetched.take(), []);
}

/// Looking for a message, and taking the one before it, prefetch it and take nothing else.
#[test]
fn the_next_slot_is_prefetched() {
    let mut rig = Rig::open(false, 3, 2);
    for id in 1..=2 {
        let _ = rig.send(id, id as u32).unwrap();
    }
    let before = rig.words.forward();
    let memory = Prefetching {
        memory: &rig.words,
        prefetched: RefCell::default(),
    };
    let [first, second] = [1, 2].map(|slot| SlotRange {
        segment: 0,
        offset: slot * 4096,
        stride: 4096,
    });
    rig.ends[RECEIVER].prefetch(&memory);
    assert_eq!(memory.prefetched.take(), [(first, true)]);
    assert_eq!(rig.words.forward(), before);
    assert!(rig.ends[RECEIVER].take(&memory).unwrap().is_some());
    assert_eq!(memory.prefetched.take(), [(first, true), (second, true)]);
    assert_eq!(rig.words.forward()[2], before[2]);
}

//= SM2-MSG-005, SM2-RNG-007 test
#[test]
fn the_application_holds_no_more_than_it_may() {
    let mut rig = Rig::open(true, 3, 2);
    for id in 1..=3 {
        let _ = rig.send(id, id as u32).unwrap();
    }
    assert_eq!((rig.taken().id, rig.taken().id), (1, 2));
    let before = rig.words.forward();
    let too_many = Err(NoDelivery::TooManyBorrowed(TooManyBorrowed {
        max_borrowed: 2,
    }));
    assert_eq!(rig.take(), too_many);
    assert_eq!(rig.words.forward(), before, "it stays in the ring");
    let _ = rig.release(2).unwrap();
    assert_eq!(rig.taken().id, 3);
}

/// Tests how many messages count as lost, and how many accesses it takes to find the oldest, for
/// each distance that the sender can be ahead.
//= SM2-RNG-007, SM2-MSG-002 test
#[test]
fn a_receiver_finds_what_a_sender_that_went_round_left() {
    for depth in [1, 2, 3, 4, 7, 8] {
        for ahead in 0..40_u64 {
            let mut rig = Rig::open(false, depth, 1);
            let depth = u64::from(depth);
            let _ = rig.send(1, 0).unwrap();
            assert_eq!(rig.taken().lost, 0);
            let _ = rig.release(1).unwrap();
            let _ = rig.harvest().unwrap();
            for id in 2..2 + ahead {
                let _ = rig.send(id, (id % (depth + 2)) as u32).unwrap();
            }
            rig.words.take_accesses();
            let mut last = 1;
            for id in (2..2 + ahead).skip(ahead.saturating_sub(depth) as usize) {
                let delivery = rig.taken();
                let expected = (id, id, id - last - 1);
                assert_eq!((delivery.id, delivery.sequence, delivery.lost), expected);
                let _ = rig.release(delivery.sequence).unwrap();
                last = id;
            }
            assert_eq!(rig.take(), Ok(None));
            // Each message takes a load, a take, a swap and a check whether the sender is parked.
            // Finding the oldest takes a load per message in the ring, and seeing that the ring is
            // empty takes one load.
            let accesses = u64::from(rig.words.take_accesses());
            assert!(accesses <= 5 * depth + 1, "{accesses} of {depth}, {ahead}");
        }
    }
}

/// The loss before the first message that is taken follows from its sequence number.
//= SM2-MSG-002 test
#[test]
fn lost_before_the_first_and_never_offered() {
    let mut rig = Rig::open(false, 2, 1);
    for id in [100, 101, 105] {
        let _ = rig.send(id, (id % 7) as u32).unwrap();
    }
    let first = rig.taken();
    assert_eq!((first.sequence, first.id, first.lost), (2, 101, 1));
    let _ = rig.release(2).unwrap();
    assert_eq!(
        rig.taken().lost,
        3,
        "those that this link never had count too"
    );
}

/// Words that let another operation change the ring just before some access.
struct Meanwhile<'a> {
    memory: &'a Memory,
    accesses: Cell<u32>,
    at: u32,
    then: &'a dyn Fn(&Memory),
}

impl Meanwhile<'_> {
    fn count(&self) {
        self.accesses.set(self.accesses.get() + 1);
        if self.accesses.get() == self.at {
            (self.then)(self.memory);
        }
    }
}

impl RingMemory for Meanwhile<'_> {
    fn load(&self, at: At) -> u64 {
        self.count();
        self.memory.load(at)
    }

    fn swap(&self, at: At, bits: u64) -> u64 {
        self.count();
        self.memory.swap(at, bits)
    }

    fn take(&self, at: At, bits: u64) -> bool {
        self.count();
        self.memory.take(at, bits)
    }

    fn write_cell(&self, index: u32, words: &[u64]) {
        self.count();
        self.memory.write_cell(index, words);
    }

    fn read_cell(&self, index: u32, words: &mut [u64]) {
        self.count();
        self.memory.read_cell(index, words);
    }

    fn fence(&self) {
        self.memory.fence();
    }
}

/// The sender displaces the word between the receiver's load and its take, so the receiver reads
/// again.
//= SM2-RNG-007 test
#[test]
fn a_word_that_was_displaced_is_not_taken() {
    let mut rig = Rig::open(false, 2, 1);
    let _ = rig.send(1, 1).unwrap();
    let _ = rig.send(2, 2).unwrap();
    let went_on = |memory: &Memory| {
        memory.write(At::Forward(1), word(0, 3, 3));
    };
    let words = Meanwhile {
        memory: &rig.words,
        accesses: Cell::new(0),
        at: 2,
        then: &went_on,
    };
    let copy = |slot: SlotRange| {
        assert_eq!(slot.offset, 2 * 4096, "the second is the oldest now");
        Some(head(2).to_bytes())
    };
    let delivery = rig.ends[RECEIVER]
        .take(&LentRing::new(&words, copy))
        .unwrap()
        .unwrap();
    assert_eq!((delivery.sequence, delivery.lost), (2, 1));
    // Load, failed take, load of the third word, load and take of the second.
    assert_eq!(words.accesses.get(), 5);
    assert_eq!(rig.words.forward(), [EMPTY, word(0, 3, 3)]);
}

/// Segments are announced on the socket, so a word can name a segment whose ATTACH the receiver has
/// not read yet.
//= SM2-RNG-007 test
#[test]
fn a_segment_that_is_attached_meanwhile() {
    let mut rig = Rig::open(false, 2, 1);
    rig.attach(segment(1));
    let _ = rig.send_in(segment(1), 1, 0).unwrap();
    let before = (rig.ends[RECEIVER].clone(), rig.words.forward());
    assert_eq!(rig.take(), Err(NoDelivery::UnknownSegment));
    assert_eq!((rig.ends[RECEIVER].clone(), rig.words.forward()), before);
    rig.pump();
    assert_eq!(rig.taken().id, 1);
}

//= SM2-RNG-007 test
#[test]
fn a_segment_that_is_unknown_once_the_socket_is_read() {
    let mut rig = Rig::open(false, 2, 1);
    rig.words.write(At::Forward(1), word(1, 0, 1));
    assert_eq!(rig.take(), Err(NoDelivery::UnknownSegment));
    let _ = rig.ends[RECEIVER].handle(NOW, Input::SegmentMissing);
    rig.drain(RECEIVER);
    let end = End::Violation(violation!(UnknownSegment, "SM2-RNG-007"));
    assert_eq!(rig.outputs[RECEIVER].last(), Some(&Output::Ended(end)));
    let close = Frame::Close(ViolationKind::UnknownSegment.code()).to_vec();
    assert_eq!(rig.wires[RECEIVER].back().unwrap().0, close);
    assert_eq!(rig.take(), Ok(None), "nothing is taken after a violation");
}

//= SM2-RNG-009, SM2-SEG-005 test
#[test]
fn a_segment_of_a_message_that_is_held_is_busy() {
    let mut rig = Rig::open(false, 2, 1);
    let _ = rig.send(1, 1).unwrap();
    rig.taken();
    let bytes = Frame::Detach { segment: 0 }.to_vec();
    let end = End::Violation(violation!(SegmentBusy, "SM2-SEG-005"));
    let datagram = sm2_proto::Datagram::new(&bytes);
    let result = rig.input(RECEIVER, Input::Datagram(datagram));
    assert_eq!(result, Err(Error::Ended(end)));
}

/// Until DETACHED is sent, the segment's number is not free and the segment counts. So a sender
/// that reads nothing cannot make the receiver remember more than 256 segments.
//= SM2-RNG-009, SM2-SEG-004 test
#[test]
fn segments_that_are_leaving_count() {
    let attach = |rig: &mut Rig, id| {
        let frame = Frame::Attach(segment(id)).to_vec();
        let fds = [pooled(16 * 4096)];
        let datagram = sm2_proto::Datagram {
            bytes: &frame,
            fds: &fds,
            ..sm2_proto::Datagram::default()
        };
        rig.input(RECEIVER, Input::Datagram(datagram))
    };
    let full = || {
        let mut rig = Rig::open(false, 2, 1);
        rig.ends[RECEIVER].handle(NOW, Input::Blocked).unwrap();
        for id in 1..256 {
            attach(&mut rig, id).unwrap();
            rig.frame(RECEIVER, &Frame::Detach { segment: id }, &[]);
        }
        rig
    };
    let violation = |violation| Err(Error::Ended(End::Violation(violation)));
    let limit = violation(violation!(SegmentLimit, "SM2-SEG-004"));
    assert_eq!(attach(&mut full(), 256), limit);
    let number = violation(violation!(BadSegmentId, "SM2-SEG-003"));
    assert_eq!(attach(&mut full(), 7), number);
    let mut rig = full();
    rig.input(RECEIVER, Input::Writable).unwrap();
    assert_eq!(rig.underway(RECEIVER), [FrameKind::Detached; 255]);
    assert_eq!(attach(&mut rig, 7), Ok(()));
}

/// Messages left in the ring when the link ends can still be taken, in order and with their
/// segments.
//= SM2-RNG-010, SM2-OPN-007, SM2-OPN-009 test
#[test]
fn what_is_left_can_be_taken() {
    for ends_with in 0..3 {
        let mut rig = Rig::open(false, 3, 2);
        for id in 1..=5 {
            let _ = rig.send(id, id as u32).unwrap();
        }
        let held = rig.taken();
        match ends_with {
            0 => rig.input(RECEIVER, Input::Eof).unwrap(),
            1 => {
                rig.input(SENDER, Input::Close(Farewell::Done.code()))
                    .unwrap();
                rig.pump();
            }
            _ => {
                let close = Input::Close(Farewell::Done.code());
                rig.input(RECEIVER, close).unwrap();
            }
        }
        assert!(rig.ends[RECEIVER].end().is_some());
        assert!(rig.ends[RECEIVER].may_take(&rig.words));
        assert_eq!(rig.taken().id, 4);
        assert!(matches!(rig.take(), Err(NoDelivery::TooManyBorrowed(_))));
        let end = Error::Ended(rig.ends[RECEIVER].end().unwrap());
        assert_eq!(rig.release(held.sequence), Err(end));
        // The sender may not know of the end yet, so it must see the messages given back.
        assert_eq!(rig.words.back()[0], word(0, 3, 3));
        assert_eq!(rig.taken().id, 5);
        assert!(!rig.ends[RECEIVER].may_take(&rig.words));
    }
}

/// After the end, the receiver takes a bounded number of messages from a sender that does not know
/// of the end and continues. Until then the sender sees a receiver that obeys its window.
//= SM2-RNG-010 test
#[test]
fn depth_messages_at_most_are_left() {
    let mut rig = Rig::open(false, 2, 1);
    let _ = rig.send(1, 1).unwrap();
    rig.input(RECEIVER, Input::Eof).unwrap();
    for id in 2..6 {
        let delivery = rig.take();
        if id < 4 {
            let sequence = delivery.unwrap().unwrap().sequence;
            let _ = rig.release(sequence);
        } else {
            assert_eq!(delivery, Ok(None));
            assert!(!rig.ends[RECEIVER].may_take(&rig.words));
            assert_eq!(rig.ends[RECEIVER].untaken(&rig.words), 0);
        }
        let _ = rig.send(id, id as u32).unwrap();
    }
}

/// A wrong word after the end of the link ends the taking of left messages. The reason of the end
/// does not change.
//= SM2-RNG-010 test
#[test]
fn a_bad_word_after_the_end() {
    let mut rig = Rig::open(false, 2, 1);
    let _ = rig.send(1, 1).unwrap();
    let _ = rig.send(2, 2).unwrap();
    rig.input(RECEIVER, Input::Eof).unwrap();
    rig.words.write(At::Forward(1), 5);
    assert_eq!(rig.take(), Err(NoDelivery::Ended(End::Eof)));
    assert_eq!(rig.ends[RECEIVER].end(), Some(End::Eof));
    assert_eq!(rig.take(), Ok(None));
}

/// A sender is killed after it has removed the oldest word and before it puts the next one.
//= SM2-RNG-006, SM2-RNG-010 test
#[test]
fn a_sender_that_died_while_it_made_room() {
    let mut rig = Rig::open(false, 3, 1);
    for id in 1..=3 {
        let _ = rig.send(id, id as u32).unwrap();
    }
    rig.words.write(At::Forward(1), EMPTY);
    assert!(!rig.ends[RECEIVER].may_take(&rig.words));
    assert_eq!(rig.take(), Ok(None), "the sender may still be at it");
    rig.input(RECEIVER, Input::Eof).unwrap();
    assert!(rig.ends[RECEIVER].may_take(&rig.words));
    for (sequence, lost) in [(2, 1), (3, 0)] {
        let delivery = rig.taken();
        assert_eq!((delivery.sequence, delivery.lost), (sequence, lost));
        let _ = rig.release(sequence);
    }
    assert_eq!(rig.take(), Ok(None));
    // The ring is empty, so repeated calls of `take` change nothing.
    let before = rig.ends[RECEIVER].clone();
    assert_eq!(rig.take(), Ok(None));
    assert_eq!(rig.ends[RECEIVER], before);
}

/// When a segment's number is used again, the geometry of the new segment applies.
//= SM2-RNG-009 test
#[test]
fn a_number_with_another_form() {
    let mut rig = Rig::open(false, 2, 1);
    rig.input(SENDER, Input::Retire { segment: 0 }).unwrap();
    rig.pump();
    let large = SegmentInfo {
        id: 0,
        stride: 8192,
        slots: 2,
    };
    rig.attach(large);
    rig.pump();
    let _ = rig.send_in(large, 1, 1).unwrap();
    let Payload::Pooled { offset, .. } = rig.taken().payload else {
        panic!("it is pooled");
    };
    assert_eq!(offset, 8192);
    assert_eq!(
        rig.release(2),
        Err(Error::Misuse(Misuse::NotBorrowed)),
        "no such message"
    );
}
