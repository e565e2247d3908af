//! Harnesses for the receiver's side of a ring, with words that can have any value.

use core::cell::Cell;

use super::{
    super::proofs::{SEQUENCES, take},
    At, CELL_WORDS, CellWord, EMPTY, Misuse, NotReleased, NotTaken, RING_DISPLACED_MAX, RingLayout,
    RingMemory, RingReceiver, SlotHead, Wake, Word,
};
use crate::{
    Instant,
    link::{Carrier, Delivery, MaxLen, Payload, Status, segments::Geometry, wire::Given},
    proofs::{below, one_of},
};

/// The smallest depth, depths that do and do not divide 2^32, and the largest depth.
const DEPTHS: [u16; 4] = [1, 2, 3, 1_024];

fn receiver(depth: u16, reliable: bool, next: u64) -> RingReceiver {
    let layout = RingLayout::new(depth, u32::from(depth) + 2).expect("a legal layout");
    RingReceiver {
        next,
        ..RingReceiver::new(layout, Carrier::Data, reliable, false, 2, MaxLen::GREATEST)
    }
}

/// RNG-FIFO: for each low half of a sequence number, the word names the expected message, or a
/// message that is later by whole rounds and not further ahead than a legal sender can be, or is
/// invalid.
//= SM2-RNG-007, SM2-RNG-010 kani
// Shows RNG-FIFO (BoundariesAndSamples), bound: depth up to 4.
#[cfg_attr(kani, kani::proof)]
fn only_later_rounds_are_believed() {
    let depth = one_of(&DEPTHS);
    let reliable = kani::any();
    let next = one_of(&SEQUENCES);
    let rounds = u64::from(depth);
    // Any distance, and distances next to the boundaries of the rule.
    let ahead: u32 = match below(4) {
        0 => kani::any(),
        1 => (rounds * u64::from(kani::any::<u8>())) as u32,
        2 => {
            RING_DISPLACED_MAX.next_multiple_of(depth.into())
                - u32::from(depth) * u32::from(kani::any::<bool>())
        }
        _ => 0_u32.wrapping_sub(u32::from(depth) * kani::any::<u8>() as u32),
    };
    let mut receiver = receiver(depth, reliable, next);
    let verdict = receiver.is_expected((next as u32).wrapping_add(ahead));
    let ahead = u64::from(ahead);
    let goes_round = !reliable && ahead % rounds == 0 && ahead < (1 << 31) + rounds;
    match verdict {
        Ok(true) => assert!(ahead == 0 && receiver.next == next),
        Ok(false) => {
            assert!(goes_round && ahead > 0);
            assert_eq!(receiver.next, next + ahead - rounds + 1);
        }
        Err(violation) => {
            assert!(violation == violation!(BadWord, "SM2-RNG-007") && ahead > 0 && !goes_round);
            assert_eq!(receiver.next, next);
        }
    }
    kani::cover!(
        verdict == Ok(false) && ahead > u64::from(u32::MAX / 2),
        "just not too far"
    );
    kani::cover!(
        verdict.is_err() && ahead % rounds == 0 && !reliable,
        "of the past"
    );
}

/// The last sequence numbers do not cause a panic.
//= SM2-RNG-007 kani
// Shows RNG-HOSTILE (Exhaustive), bound: the last sequence numbers.
#[cfg_attr(kani, kani::proof)]
fn numbers_end() {
    let next = u64::MAX - below(128) as u64;
    let mut receiver = receiver(1, false, next);
    let ahead = u32::from(kani::any::<u8>());
    let sequence = (next as u32).wrapping_add(ahead);
    let bits = match kani::any() {
        false => Word {
            segment: 0,
            slot: 0,
            sequence,
        }
        .to_bits(),
        true => cell(0, Status::Ok, sequence),
    };
    let words = Answers {
        next: Cell::new(0),
        answers: [bits, 1, bits, 1],
        accesses: Cell::new(0),
        depth: 1,
        id: 1,
    };
    let mut head = [0; 64];
    head[0] = 1;
    let taken = take(&mut receiver, &words, Geometry::new(4_096, 1), |_| {
        Some(head)
    });
    assert!(receiver.next >= next);
    kani::cover!(
        taken == Err(NotTaken::Violation(violation!(BadWord, "SM2-RNG-007"))),
        "the last"
    );
    kani::cover!(matches!(taken, Ok(Some(_))), "one of the last");
}

/// The bits of the word of a message in a cell.
fn cell(len: u8, status: Status, sequence: u32) -> u64 {
    CellWord {
        len,
        status,
        sequence,
    }
    .to_bits()
}

/// A ring memory that answers each access with the next of these values, and each access to a cell with this id.
struct Answers {
    next: Cell<usize>,
    answers: [u64; 4],
    accesses: Cell<u32>,
    depth: u32,
    id: u64,
}

impl Answers {
    fn answer(&self, at: At) -> u64 {
        match at {
            At::Forward(index) => assert!(index < self.depth),
            At::Back(index) => assert!(index < self.depth + 2),
            At::ReceiverParked | At::SenderParked => {}
        }
        self.accesses.set(self.accesses.get() + 1);
        let at = self.next.replace(self.next.get() + 1);
        self.answers[at % self.answers.len()]
    }
}

impl RingMemory for Answers {
    fn load(&self, at: At) -> u64 {
        self.answer(at)
    }

    fn swap(&self, at: At, _: u64) -> u64 {
        self.answer(at)
    }

    fn take(&self, at: At, _: u64) -> bool {
        self.answer(at) & 1 == 1
    }

    fn write_cell(&self, _: u32, _: &[u64]) {
        panic!("a receiver does not")
    }

    fn read_cell(&self, index: u32, words: &mut [u64]) {
        assert!(index < self.depth && words.len() <= CELL_WORDS);
        words.fill(self.id);
    }

    fn fence(&self) {}
}

/// One of the words that a peer can write where message 5 is expected.
fn any_word() -> u64 {
    let word = |slot, sequence| {
        Word {
            segment: 0,
            slot,
            sequence,
        }
        .to_bits()
    };
    one_of(&[
        EMPTY,
        1,
        word(0, 5),
        word(1, 5),
        word(2, 5),
        word(0, 7),
        cell(104, Status::Ok, 5),
        cell(3, Status::Ok, 7),
        cell(105, Status::Ok, 5),
        cell(0, Status::Failed, 5),
    ])
}

/// Checks a message that came by one of these words, with the id 9 after the id 4.
fn check_delivery(receiver: &RingReceiver, delivery: &Delivery) {
    assert!(delivery.id == 9 && delivery.lost == 4 && delivery.status == Status::Ok);
    match &delivery.payload {
        Payload::Pooled { offset, .. } => {
            assert!(offset + delivery.len + 64 <= 8_192);
            assert!(
                *offset == 0 || receiver.borrowed.len() == 1,
                "slot 1 may be held"
            );
        }
        Payload::Cell(bytes) => {
            let number = (bytes.len(), delivery.sequence);
            assert!(receiver.cells && matches!(number, (104, 5) | (3, 7)));
            kani::cover!(receiver.left == Some(0), "the last one, in a cell");
        }
        other => panic!("{other:?}"),
    }
}

/// RNG-HOSTILE: whatever the words contain, `take` makes a bounded number of accesses. It returns
/// nothing, or a message that lies in its segment and that the application does not hold yet.
//= SM2-RNG-007, SM2-RNG-010, SM2-RNG-013, SM2-PAY-003, SM2-PAY-005 kani
// Shows RNG-HOSTILE (Samples), bound: one step, any words.
#[cfg_attr(kani, kani::proof)]
// Two rounds of two words, and the same number of accesses to find the oldest message; four
// answers.
#[cfg_attr(kani, kani::unwind(66))]
fn a_look_at_any_words() {
    let (depth, next) = (one_of(&[1, 2]), 5);
    let mut receiver = receiver(depth, kani::any(), next);
    let held = Word {
        segment: 0,
        slot: 1,
        sequence: 4,
    };
    if kani::any() {
        receiver.borrowed.push(4, held);
    }
    if kani::any() {
        receiver.end(kani::any());
    }
    receiver.cells = kani::any();
    receiver.last_id = Some(4);
    let words = Answers {
        next: Cell::new(0),
        answers: [any_word(), any_word(), any_word(), any_word()],
        accesses: Cell::new(0),
        depth: depth.into(),
        id: one_of(&[4, 9]),
    };
    let head = SlotHead {
        id: 9,
        time: Instant(0),
        len: one_of(&[0, 4_032, 4_033]),
        status: Status::Ok,
    };
    let copies = Cell::new(0);
    let taken = take(&mut receiver, &words, Geometry::new(4_096, 2), |slot| {
        assert!(slot.offset + slot.stride <= 8_192);
        copies.set(copies.get() + 1);
        Some(head.to_bytes())
    });
    assert!(words.accesses.get() <= 6 * u32::from(depth) && copies.get() <= 1);
    receiver.invariants();
    assert!(receiver.next >= next);
    if let Ok(Some(delivery)) = &taken {
        assert!(delivery.sequence >= next && receiver.next == delivery.sequence + 1);
        check_delivery(&receiver, delivery);
        assert_eq!(
            copies.get() == 0,
            matches!(delivery.payload, Payload::Cell(_))
        );
        kani::cover!(delivery.sequence > 5, "after a round");
    }
    kani::cover!(
        taken == Err(NotTaken::Violation(violation!(SlotBusy, "SM2-RNG-007"))),
        "it is held"
    );
    kani::cover!(
        taken == Err(NotTaken::Violation(violation!(BadId, "SM2-RNG-013"))),
        "a cell with an id of the past"
    );
    kani::cover!(
        receiver.left == Some(0) && taken == Ok(None),
        "nothing is left"
    );
}

/// RNG-HOSTILE: a message is given back once and within bounds, whatever the back word contained.
//= SM2-RNG-008, SM2-MSG-004 kani
// Shows RNG-HOSTILE (Exhaustive), bound: one step, any words.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(6))]
fn a_message_is_given_back_once() {
    let mut receiver = receiver(2, kani::any(), 5);
    let word = Word {
        segment: 0,
        slot: 1,
        sequence: 4,
    };
    receiver.borrowed.push(4, word);
    receiver.given = one_of(&[0, 3, 4, u64::from(u32::MAX)]);
    let any = || one_of(&[0, 1, 2, u64::MAX]);
    let words = Answers {
        next: Cell::new(0),
        answers: [any(), any(), any(), 0],
        accesses: Cell::new(0),
        depth: 2,
        id: 0,
    };
    let sequence = one_of(&[3, 4, u64::MAX]);
    let released = receiver.release_all(&words, [sequence], Given::Consumed);
    let not_held = Err(NotReleased::Misuse(Misuse::NotBorrowed));
    let not_free = Err(NotReleased::Violation(violation!(BadWord, "SM2-RNG-008")));
    assert_eq!(released != not_held, sequence == 4);
    assert!(words.accesses.get() <= 3);
    if released != not_held {
        assert_eq!(released == not_free, words.answers[0] != 0);
        assert_eq!(
            receiver.release_all(&words, [sequence], Given::Consumed),
            not_held
        );
    }
    kani::cover!(released == Ok(Wake::Needed), "with a bell");
    kani::cover!(released == not_free, "the word was not free");
}

#[cfg(test)]
kani::explored! {
    only_later_rounds_are_believed: 2,
    numbers_end: 2,
    a_look_at_any_words: 5,
    a_message_is_given_back_once: 2,
}
