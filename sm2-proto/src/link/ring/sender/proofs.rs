//! Harnesses for the sender's side of a ring, with words that can have any value.

use alloc::vec::Vec;
use core::cell::Cell;

use super::{
    super::{
        super::{Counters, SegmentInfo, Status},
        proofs::SEQUENCES,
    },
    At, Carrier, CellMessage, CellWord, EMPTY, Fate, Misuse, RING_DISPLACED_MAX, RingLayout,
    RingMemory, RingMessage, RingSendError, RingSender, Wake, Word,
};
use crate::{
    Instant,
    proofs::{below, one_of},
};

const SEGMENT: SegmentInfo = SegmentInfo {
    id: 1,
    stride: 4_096,
    slots: 8,
};

/// A ring memory that first answers as a legal receiver would, then gives any answers, and then
/// answers `EMPTY`.
struct Answers {
    right: [Cell<u64>; 7],
    /// Each answer is chosen when it is given.
    answers: [Cell<u64>; 5],
    /// How many of the answers were given; `None` while the other end obeys SPEC.
    given: Cell<Option<usize>>,
    accesses: Cell<u32>,
}

impl Answers {
    fn new() -> Self {
        Self {
            right: [const { Cell::new(EMPTY) }; 7],
            answers: [const { Cell::new(EMPTY) }; 5],
            given: Cell::new(None),
            accesses: Cell::new(0),
        }
    }

    /// The word of a ring with depth 2 and window 3.
    fn right(&self, at: At) -> &Cell<u64> {
        match at {
            At::ReceiverParked => &self.right[0],
            At::SenderParked => &self.right[1],
            At::Forward(index @ 0..2) => &self.right[2 + index as usize],
            At::Back(index @ 0..3) => &self.right[4 + index as usize],
            At::Forward(_) | At::Back(_) => panic!("{at:?} is outside"),
        }
    }

    fn answer(&self, right: u64) -> u64 {
        self.accesses.set(self.accesses.get() + 1);
        match self.given.get() {
            None => right,
            Some(given) => {
                self.given.set(Some(given + 1));
                let Some(answer) = self.answers.get(given) else {
                    return EMPTY;
                };
                answer.set(any_answer());
                answer.get()
            }
        }
    }

    fn has_given(&self, bits: u64) -> bool {
        self.answers.iter().any(|it| it.get() == bits)
    }
}

impl RingMemory for Answers {
    fn load(&self, at: At) -> u64 {
        self.answer(self.right(at).get())
    }

    fn swap(&self, at: At, bits: u64) -> u64 {
        let right = self.right(at).replace(bits);
        self.answer(right)
    }

    fn take(&self, _: At, _: u64) -> bool {
        panic!("a sender does not")
    }

    /// A cell is written only while its forward word is empty.
    fn write_cell(&self, index: u32, words: &[u64]) {
        assert!(index < 2 && words.len() <= 15);
        assert!(self.given.get().is_some() || self.right(At::Forward(index)).get() == EMPTY);
    }

    fn read_cell(&self, _: u32, _: &mut [u64]) {
        panic!("a sender does not")
    }

    fn fence(&self) {}
}

fn message(number: u64) -> RingMessage {
    RingMessage {
        key: 10 * number,
        id: number,
        len: 0,
        segment: SEGMENT,
        slot: number as u32,
    }
}

fn short(number: u64) -> CellMessage<'static> {
    CellMessage {
        id: number,
        time: Instant(0),
        status: Status::Ok,
        bytes: &[7],
    }
}

/// A sender that has sent `sent` messages; the first `taken` of them were taken and not given
/// back. Those in `cells` are in cells, the others in slots.
fn sender(sent: u64, taken: u64, reliable: bool, cells: &[u64], words: &Answers) -> RingSender {
    let layout = RingLayout::new(2, 3).expect("a legal layout");
    let mut sender = RingSender::new(layout, Carrier::Data, reliable, false);
    assert_eq!(sender.segments.attach(&SEGMENT), Ok(()));
    while sender.segments.poll().is_some() {}
    for number in 1..=sent {
        let mut settled = |_, _| panic!("nothing is settled");
        let result = match cells.contains(&number) {
            false => sender.send(words, &message(number), &mut settled),
            true => sender.send_in_cell(words, &short(number), &mut settled),
        };
        assert_eq!(result, Ok(Wake::NotNeeded));
        if number <= taken {
            words.right(layout.forward(number)).set(EMPTY);
        }
    }
    words.accesses.set(0);
    words.given.set(Some(0));
    sender
}

/// The word of the message with this number.
fn word(number: u64) -> u64 {
    Word::new(1, number as u32, number).map_or(0, Word::to_bits)
}

/// The word of the message with this number in a cell.
fn cell(number: u64) -> u64 {
    CellWord::new(1, Status::Ok, number).map_or(0, CellWord::to_bits)
}

/// One of the words that a peer can write: empty, invalid, or the word of any message in a slot or a cell.
fn any_answer() -> u64 {
    // The slot of one message with the sequence number of another.
    let wrong = Word::new(1, 1, 2).map_or(0, Word::to_bits);
    let words = [word(1), word(2), word(3), word(4)];
    let cells = [cell(1), cell(2), cell(3)];
    let all = [[EMPTY, wrong].as_slice(), &words, &cells].concat();
    one_of(&all)
}

/// How many messages were sent and how many of them were taken, as far as a window of three allows.
const STATES: [(u64, u64); 5] = [(0, 0), (1, 1), (2, 0), (2, 1), (3, 1)];

/// Which messages are in cells.
const CELLS: [&[u64]; 4] = [&[], &[1], &[2], &[1, 2, 3]];

/// RNG-HOSTILE: sends one more message while the words have any values. The call makes a bounded
/// number of accesses, each message is settled at most once, and the counters stay consistent.
//= SM2-RNG-005, SM2-RNG-006, SM2-RNG-008, SM2-RNG-013, SM2-QOS-006 kani
// Shows RNG-HOSTILE (Exhaustive), bound: one step, any words.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(17))]
fn a_message_to_any_words() {
    let (sent, taken) = one_of(&STATES);
    let cells = one_of(&CELLS);
    let words = Answers::new();
    let (reliable, in_cell) = (kani::any(), kani::any());
    let mut sender = sender(sent, taken, reliable, cells, &words);
    let before = sender.counters();
    let mut settled = Vec::new();
    let mut settle = |key, fate| settled.push((key, fate));
    let result = match in_cell {
        false => sender.send(&words, &message(sent + 1), &mut settle),
        true => sender.send_in_cell(&words, &short(sent + 1), &mut settle),
    };
    // One access to empty the index of a full window, two for each of three back words, and one for
    // each of two cells; then two to empty the cell, a put, and two to the parked word.
    assert!(words.accesses.get() <= 14);
    let is_in_slot = |key: u64| key <= 10 * sent && !cells.contains(&(key / 10));
    let only_known = settled.iter().all(|it| is_in_slot(it.0));
    assert!(only_known, "only what was sent before, in slots");
    let is_double = |at: usize| settled[at + 1..].iter().any(|it| it.0 == settled[at].0);
    assert!(!(0..settled.len()).any(is_double), "settled once");
    let books = sender.counters();
    let refused = matches!(result, Err(RingSendError::Misuse(Misuse::NoRoom)));
    assert_eq!(books.offered, sent + u64::from(!refused));
    assert!(books.is_balanced());
    let all = |it: Counters| it.delivered + it.discarded;
    let from_cells = all(books) - all(before) - settled.len() as u64;
    assert!(from_cells <= cells.iter().filter(|it| **it <= sent).count() as u64);
    assert!(!refused || reliable && settled.is_empty() && words.accesses.get() <= 1);
    assert!(!reliable || settled.is_empty(), "nothing is displaced");
    assert!(!reliable || books.discarded == 0, "not from cells either");
    if result.is_ok() {
        sender.invariants();
    }
    let mut closed = 0;
    sender.end(|_| closed += 1);
    assert!(closed <= books.in_flight);
    assert_eq!(sender.counters().closed, books.in_flight);
    sender.invariants();
    kani::cover!(
        settled.len() == 2 && result.is_ok(),
        "displaced, and one came back"
    );
    kani::cover!(
        in_cell && from_cells == 1 && books.discarded == 1 && result.is_ok(),
        "a cell displaced a cell"
    );
    kani::cover!(
        result
            == Err(RingSendError::Violation(violation!(
                WindowExceeded,
                "SM2-RNG-006"
            ))),
        "full"
    );
    kani::cover!(
        result == Err(RingSendError::Violation(violation!(BadWord, "SM2-RNG-005"))),
        "wrong"
    );
}

/// RNG-HOSTILE: a word that claims to give a message back either names an unsettled message, or is
/// a violation. A message in a cell is settled by an empty word, and only by that.
//= SM2-RNG-008, SM2-RNG-013, SM2-MSG-004 kani
// Shows RNG-HOSTILE (Samples), bound: one step, any words.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(17))]
fn any_words_given_back() {
    let (sent, taken) = one_of(&STATES);
    let cells = one_of(&CELLS);
    let words = Answers::new();
    let mut sender = sender(sent, taken, kani::any(), cells, &words);
    let before = sender.counters();
    sender.returned = one_of(&[0, 2, 1 << 33]);
    let mut settled = Vec::new();
    let result = sender.harvest(&words, &mut |key, fate| settled.push((key, fate)));
    assert!(words.accesses.get() <= 8);
    let is_in_slot = |key: u64| key <= 10 * sent && !cells.contains(&(key / 10));
    assert!(
        settled
            .iter()
            .all(|it| it.1 == Fate::Delivered && is_in_slot(it.0))
    );
    assert!(
        settled.iter().all(|it| words.has_given(word(it.0 / 10))),
        "nobody gave it back"
    );
    let is_double = |at: usize| settled[at + 1..].iter().any(|it| it.0 == settled[at].0);
    assert!(!(0..settled.len()).any(is_double), "settled once");
    let books = sender.counters();
    assert!(books.is_balanced() && books.discarded == 0);
    let from_cells = books.delivered - before.delivered - settled.len() as u64;
    assert!(from_cells <= before.in_flight && (from_cells == 0 || !cells.is_empty()));
    assert!(from_cells == 0 || result.is_ok());
    sender.invariants();
    kani::cover!(result.is_ok() && settled.len() == 2, "two came back");
    kani::cover!(from_cells == 2, "two were taken from cells");
    kani::cover!(
        result == Err(violation!(BadWord, "SM2-RNG-008")) && settled.len() == 1,
        "the second is wrong"
    );
}

/// RNG-FIFO: the link ends if the receiver takes nothing while 2^31 messages are displaced, even if
/// the application holds as many messages as it may. The low halves of sequence numbers therefore
/// stay unambiguous.
//= SM2-RNG-010, SM2-RNG-013 kani
// Shows RNG-FIFO (Exhaustive), bound: around 2^31.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(17))]
fn a_stopped_receiver_is_given_up() {
    let words = Answers::new();
    // While the application holds one message, the window is full, so each message is taken out
    // before the next is put.
    let held = u64::from(kani::any::<bool>());
    let sent = 2 + held;
    // In either case, the messages in the ring are in slots or in cells.
    let in_cells = kani::any();
    let cells: &[u64] = if in_cells { &[2, 3] } else { &[] };
    let mut sender = sender(sent, held, false, cells, &words);
    words.given.set(None);
    let before = RING_DISPLACED_MAX - 1 - below(3) as u32;
    sender.displaced = before;
    let mut settle = |_, fate| assert_eq!(fate, Fate::Discarded);
    let mut count = before;
    let mut stopped = false;
    for number in sent + 1..sent + 4 {
        let result = match in_cells {
            false => sender.send(&words, &message(number), &mut settle),
            true => sender.send_in_cell(&words, &short(number), &mut settle),
        };
        count += 1;
        stopped = result == Err(RingSendError::Stopped);
        assert_eq!(stopped, count == RING_DISPLACED_MAX);
        assert!(stopped || result == Ok(Wake::NotNeeded));
        if stopped {
            break;
        }
    }
    assert!(sender.counters().discarded > 0 && stopped);
    kani::cover!(
        held == 1 && count - before == 3,
        "in three steps of a full window"
    );
}

/// The count of displaced messages starts again when the receiver takes one.
//= SM2-RNG-010, SM2-RNG-013 kani
// Shows RNG-FIFO (Exhaustive), bound: around 2^31.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(17))]
fn one_taken_begins_the_count_anew() {
    let words = Answers::new();
    let cells = one_of(&CELLS);
    let mut sender = sender(2, 0, false, cells, &words);
    words.given.set(None);
    sender.displaced = RING_DISPLACED_MAX - 1;
    let taken = kani::any();
    if taken {
        words.right(At::Forward(1)).set(EMPTY);
    }
    let result = match kani::any() {
        false => sender.send(&words, &message(3), &mut |_, _| {}),
        true => sender.send_in_cell(&words, &short(3), &mut |_, _| {}),
    };
    assert_eq!(result == Err(RingSendError::Stopped), !taken);
    assert_eq!(sender.displaced == 0, taken);
    kani::cover!(taken, "taken");
    kani::cover!(!taken, "not taken");
}

/// RNG-FIFO: messages in cells are settled at any sequence number, also where the low half begins
/// again, and the debt with them. A sender that sent none for long finds the next ones in a few steps.
//= SM2-RNG-013, SM2-QOS-003 kani
// Shows RNG-FIFO (Exhaustive), bound: boundary values of sequence numbers, depth 2.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(17))]
fn cells_are_settled_at_any_sequence_number() {
    let before = one_of(&SEQUENCES) - u64::from(kani::any::<bool>());
    let words = Answers::new();
    let mut sender = sender(0, 0, true, &[], &words);
    words.given.set(None);
    sender.sequence = before;
    for id in 1..=2 {
        let sent = sender.send_in_cell(&words, &short(id), &mut |_, _| {});
        assert_eq!(sent, Ok(Wake::NotNeeded));
    }
    sender.drop_publication(Fate::NoRoom);
    for number in 1..=2 {
        assert_eq!(sender.harvest(&words, &mut |_, _| {}), Ok(()));
        assert!(sender.owes() && sender.counters().delivered == number - 1);
        let at = sender.layout.forward(before + number);
        words.right(at).set(EMPTY);
    }
    // The call for a new message looks at the next index, and settles the message there.
    if kani::any() {
        let sent = sender.send_in_cell(&words, &short(3), &mut |_, _| {});
        assert!(sent.is_ok() && !sender.owes());
    }
    assert_eq!(sender.harvest(&words, &mut |_, _| {}), Ok(()));
    assert!(!sender.owes() && sender.counters().delivered == 2);
    sender.invariants();
    kani::cover!(before as u32 == u32::MAX, "the low half begins again");
}

#[cfg(test)]
kani::explored! {
    a_message_to_any_words: 4,
    any_words_given_back: 3,
    a_stopped_receiver_is_given_up: 1,
    one_taken_begins_the_count_anew: 2,
    cells_are_settled_at_any_sequence_number: 1,
}
