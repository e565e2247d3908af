//! Harnesses for the sender's side of a ring, with words that can have any value.

use alloc::vec::Vec;
use core::cell::Cell;

use super::{
    At, Carrier, EMPTY, Fate, Misuse, RING_DISPLACED_MAX, RingLayout, RingMemory, RingMessage,
    RingSendError, RingSender, SegmentInfo, Wake, Word,
};
use crate::proofs::{below, one_of};

const SEGMENT: SegmentInfo = SegmentInfo {
    id: 1,
    stride: 4_096,
    slots: 8,
};

/// A ring memory that first answers as a legal receiver would, then gives these answers, and then
/// answers `EMPTY`.
struct Answers {
    right: [Cell<u64>; 7],
    answers: [u64; 5],
    /// How many of the answers were given; `None` while the other end obeys SPEC.
    given: Cell<Option<usize>>,
    accesses: Cell<u32>,
}

impl Answers {
    fn new(answers: [u64; 5]) -> Self {
        Self {
            right: [const { Cell::new(EMPTY) }; 7],
            answers,
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
                self.answers.get(given).copied().unwrap_or(EMPTY)
            }
        }
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

/// A sender that has sent `sent` messages; the first `taken` of them were taken and not given
/// back.
fn sender(sent: u64, taken: u64, reliable: bool, words: &Answers) -> RingSender {
    let layout = RingLayout::new(2, 3).expect("a legal layout");
    let mut sender = RingSender::new(layout, Carrier::Data, reliable, false);
    assert_eq!(sender.attach(&SEGMENT), Ok(()));
    while sender.poll().is_some() {}
    for number in 1..=sent {
        let mut settled = |_, _| panic!("nothing is settled");
        assert_eq!(
            sender.send(words, &message(number), &mut settled),
            Ok(Wake::NotNeeded)
        );
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

/// One of the words that a peer can write: empty, invalid, or the word of any message.
fn any_answer() -> u64 {
    // The slot of one message with the sequence number of another.
    let wrong = Word::new(1, 1, 2).map_or(0, Word::to_bits);
    one_of(&[EMPTY, wrong, word(1), word(2), word(3), word(4)])
}

/// How many messages were sent and how many of them were taken, as far as a window of three allows.
const STATES: [(u64, u64); 5] = [(0, 0), (1, 1), (2, 0), (2, 1), (3, 1)];

/// RNG-HOSTILE: sends one more message while the words have any values. The call makes a bounded
/// number of accesses, each message is settled at most once, and the counters stay consistent.
//= SM2-RNG-005, SM2-RNG-006, SM2-RNG-008, SM2-QOS-006 kani
// Shows RNG-HOSTILE (Exhaustive), bound: one step, any words.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(12))]
fn a_message_to_any_words() {
    let (sent, taken) = one_of(&STATES);
    let words = Answers::new(core::array::from_fn(|_| any_answer()));
    let reliable = kani::any();
    let mut sender = sender(sent, taken, reliable, &words);
    let mut settled = Vec::new();
    let next = message(sent + 1);
    let result = sender.send(&words, &next, &mut |key, fate| settled.push((key, fate)));
    // Two accesses for each of three back words, two puts, and the check of the parked word.
    assert!(words.accesses.get() <= 11);
    let named = settled.iter().map(|it| it.0);
    assert!(
        named.clone().all(|key| key <= 10 * sent),
        "only what was sent before"
    );
    let is_double = |at: usize| settled[at + 1..].iter().any(|it| it.0 == settled[at].0);
    assert!(!(0..settled.len()).any(is_double), "settled once");
    let books = sender.counters();
    let refused = matches!(result, Err(RingSendError::Misuse(Misuse::NoRoom)));
    assert_eq!(books.offered, sent + u64::from(!refused));
    assert_eq!(books.in_flight, books.offered - settled.len() as u64);
    assert!(!refused || reliable && settled.is_empty() && words.accesses.get() <= 1);
    assert!(!reliable || settled.is_empty(), "nothing is displaced");
    if result.is_ok() {
        sender.invariants();
    }
    let mut closed = 0;
    sender.end(|_| closed += 1);
    assert_eq!(closed, books.in_flight);
    sender.invariants();
    kani::cover!(
        settled.len() == 2 && result.is_ok(),
        "displaced, and one came back"
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
/// a violation.
//= SM2-RNG-008, SM2-MSG-004 kani
// Shows RNG-HOSTILE (Samples), bound: one step, any words.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(12))]
fn any_words_given_back() {
    let (sent, taken) = one_of(&STATES);
    let words = Answers::new(core::array::from_fn(|_| any_answer()));
    let mut sender = sender(sent, taken, kani::any(), &words);
    sender.returned = one_of(&[0, 2, 1 << 33]);
    let mut settled = Vec::new();
    let result = sender.harvest(&words, &mut |key, fate| settled.push((key, fate)));
    assert!(words.accesses.get() <= 6);
    assert!(
        settled
            .iter()
            .all(|it| it.1 == Fate::Delivered && it.0 <= 10 * sent)
    );
    let is_said = |key: u64| words.answers.contains(&word(key / 10));
    assert!(
        settled.iter().all(|it| is_said(it.0)),
        "nobody gave it back"
    );
    let is_double = |at: usize| settled[at + 1..].iter().any(|it| it.0 == settled[at].0);
    assert!(!(0..settled.len()).any(is_double), "settled once");
    let books = sender.counters();
    assert_eq!(
        (books.offered, books.delivered),
        (sent, settled.len() as u64)
    );
    sender.invariants();
    kani::cover!(result.is_ok() && settled.len() == 2, "two came back");
    kani::cover!(
        result == Err(violation!(BadWord, "SM2-RNG-008")) && settled.len() == 1,
        "the second is wrong"
    );
}

/// RNG-FIFO: the link ends if the receiver takes nothing while 2^31 messages are displaced, even if
/// the application holds as many messages as it may. The low halves of sequence numbers therefore
/// stay unambiguous.
//= SM2-RNG-010 kani
// Shows RNG-FIFO (Exhaustive), bound: around 2^31.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(12))]
fn a_stopped_receiver_is_given_up() {
    let words = Answers::new([EMPTY; 5]);
    // While the application holds one message, the window is full, so each message is taken out
    // before the next is put.
    let held = u64::from(kani::any::<bool>());
    let sent = 2 + held;
    let mut sender = sender(sent, held, false, &words);
    words.given.set(None);
    let before = RING_DISPLACED_MAX - 1 - below(3) as u32;
    sender.displaced = before;
    let mut displaced = 0;
    let mut settle = |_, fate| displaced += u32::from(fate == Fate::Discarded);
    let mut count = before;
    let mut stopped = false;
    for number in sent + 1..sent + 4 {
        let result = sender.send(&words, &message(number), &mut settle);
        count += 1;
        stopped = result == Err(RingSendError::Stopped);
        assert_eq!(stopped, count == RING_DISPLACED_MAX);
        assert!(stopped || result == Ok(Wake::NotNeeded));
        if stopped {
            break;
        }
    }
    assert!(displaced > 0 && stopped);
    kani::cover!(
        held == 1 && count - before == 3,
        "in three steps of a full window"
    );
}

/// The count of displaced messages starts again when the receiver takes one.
//= SM2-RNG-010 kani
// Shows RNG-FIFO (Exhaustive), bound: around 2^31.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(12))]
fn one_taken_begins_the_count_anew() {
    let words = Answers::new([EMPTY; 5]);
    let mut sender = sender(2, 0, false, &words);
    words.given.set(None);
    sender.displaced = RING_DISPLACED_MAX - 1;
    let taken = kani::any();
    if taken {
        words.right(At::Forward(1)).set(EMPTY);
    }
    let result = sender.send(&words, &message(3), &mut |_, _| {});
    assert_eq!(result == Err(RingSendError::Stopped), !taken);
    assert_eq!(sender.displaced == 0, taken);
    kani::cover!(taken, "taken");
    kani::cover!(!taken, "not taken");
}

#[cfg(test)]
kani::explored! {
    a_message_to_any_words: 3,
    any_words_given_back: 2,
    a_stopped_receiver_is_given_up: 1,
    one_taken_begins_the_count_anew: 2,
}
