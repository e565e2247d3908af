//! Every kind of word, head and order of words that SPEC section 8.5 forbids, at either end.

// Shows RNG-HOSTILE (test).

use crate::ring_support;
use crate::ring_support::{RECEIVER, Rig, SENDER, head, segment, word};
use sm2_proto::{
    Code, Instant, Violation, ViolationKind,
    limits::{MESSAGE_MAX, SLOT_HEAD},
    link::{
        At, Body, EMPTY, End, Error, Fate, FrameKind, NoDelivery, Output, SegmentInfo, Status,
        Wake, wire::Frame,
    },
    violation,
};

/// Depth 4 and two borrowed: the sequence numbers 1 to 4 are at the indices 1, 2, 3, 0.
fn rig(reliable: bool) -> Rig {
    Rig::open(reliable, 4, 2)
}

/// Three messages are sent: one is held, one is given back, one is in the ring.
fn busy(reliable: bool) -> Rig {
    let mut rig = rig(reliable);
    for id in 1..=3 {
        let _ = rig.send(id, id as u32).unwrap();
    }
    assert_eq!((rig.taken().sequence, rig.taken().sequence), (1, 2));
    let _ = rig.release(2).unwrap();
    rig
}

fn end(violation: Violation) -> End {
    End::Violation(violation)
}

/// Checks that the link has ended for good with this violation in its CLOSE, and that every message
/// is settled once.
fn assert_over(rig: &mut Rig, at: usize, violation: Violation) {
    assert_eq!(rig.ends[at].end(), Some(end(violation)), "{violation}");
    assert_eq!(rig.outputs[at].last(), Some(&Output::Ended(end(violation))));
    let close = Frame::Close(violation.code()).to_vec();
    assert_eq!(rig.wires[at].back().unwrap().0, close, "{violation}");
    assert_eq!(rig.ends[at].in_flight(), 0);
    let before = rig.ends[at].clone();
    if at == SENDER {
        assert_eq!(rig.harvest(), Err(Error::Ended(end(violation))));
        assert_eq!(rig.send(99, 9), Err(Error::Ended(end(violation))));
    } else {
        assert_eq!(rig.take(), Ok(None));
    }
    assert_eq!(rig.ends[at], before);
}

fn assert_settled_once(rig: &Rig) {
    let mut keys: Vec<u64> = rig.settled.iter().map(|it| it.0).collect();
    keys.sort_unstable();
    let unique = keys.len();
    keys.dedup();
    assert_eq!(keys.len(), unique, "{:?}", rig.settled);
}

/// Each row is a word that the receiver finds in place of that of message 3.
//= SM2-RNG-003, SM2-RNG-007, SM2-PAY-005 test
#[test]
fn words_that_a_receiver_refuses() {
    let bad = violation!(BadWord, "SM2-RNG-007");
    // Each word is tested on best-effort and on reliable links.
    let rows = [
        (1, bad),                                                 // names nothing
        (1 << 30, bad),                                           // bit 31 is missing
        (word(0, 3, 3) ^ (1 << 31), bad),                         // the same
        (word(0, 3, 4), bad), // the next message, at a wrong index
        (word(0, 3, 2), bad), // of the past
        (word(0, 3, 0), bad), // of before the first
        (word(0, 3, (1 << 32) + 3 - 4), bad), // a round before: this index, but long ago
        (word(0, 3, 3 + (1 << 31) + 4), bad), // further than a sender goes
        (word(0, 16, 3), violation!(BadSlot, "SM2-RNG-007")), // outside the segment
        (word(0, 65_535, 3), violation!(BadSlot, "SM2-RNG-007")), // the last slot there is
        (word(0, 1, 3), violation!(SlotBusy, "SM2-RNG-007")), // message 1 is held, in this slot
    ];
    for reliable in [false, true] {
        for (bits, violation) in rows {
            let mut rig = busy(reliable);
            rig.words.write(At::Forward(3), bits);
            let ended = NoDelivery::Ended(end(violation));
            assert_eq!(rig.take(), Err(ended), "{bits:x} {reliable}");
            assert_over(&mut rig, RECEIVER, violation);
        }
    }
    // Only a best-effort sender displaces messages that were not taken.
    let mut rig = busy(true);
    rig.words.write(At::Forward(3), word(0, 3, 7));
    assert_eq!(rig.take(), Err(NoDelivery::Ended(end(bad))));
    // A displaced message must have a consistent successor: here the next index has another word.
    let mut rig = busy(false);
    rig.words.write(At::Forward(3), word(0, 3, 7));
    rig.words.write(At::Forward(0), word(0, 3, 5));
    assert_eq!(rig.take(), Err(NoDelivery::Ended(end(bad))));
}

//= SM2-RNG-004, SM2-MSG-002, SM2-PAY-008 test
#[test]
fn heads_that_a_receiver_refuses() {
    let good = head(7).to_bytes();
    let with = |at: usize, value: u64| {
        let mut bytes = good;
        bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
        bytes
    };
    let longest = 4096 - SLOT_HEAD as u64;
    let rows = [
        (with(0, 2), Some(violation!(BadId, "SM2-RNG-004"))), // that of message 2
        (with(0, 1), Some(violation!(BadId, "SM2-RNG-004"))),
        (with(0, 3), None),
        (with(0, u64::MAX), None),
        (with(16, longest), None),
        (
            with(16, longest + 1),
            Some(violation!(BadLength, "SM2-RNG-004")),
        ),
        (with(16, 4096), Some(violation!(BadLength, "SM2-RNG-004"))),
        (
            with(16, u64::MAX),
            Some(violation!(BadLength, "SM2-RNG-004")),
        ),
        (
            with(24, 1),
            Some(violation!(ReservedNotZero, "SM2-RNG-004")),
        ),
        (
            with(56, 1 << 63),
            Some(violation!(ReservedNotZero, "SM2-RNG-004")),
        ),
    ];
    for (bytes, violation) in rows {
        let mut rig = busy(false);
        rig.heads.insert((0, 3), bytes);
        match violation {
            None => assert_eq!(rig.taken().sequence, 3),
            Some(violation) => {
                let ended = NoDelivery::Ended(end(violation));
                assert_eq!(rig.take(), Err(ended));
                assert_over(&mut rig, RECEIVER, violation);
            }
        }
    }
}

/// A slot can be longer than the longest message.
//= SM2-PAY-008, SM2-RNG-004 test
#[test]
fn a_message_has_its_limit_in_any_slot() {
    for (len, expected) in [(MESSAGE_MAX, true), (MESSAGE_MAX + 1, false)] {
        let mut rig = rig(false);
        rig.attach(SegmentInfo {
            id: 1,
            stride: 2 * MESSAGE_MAX,
            slots: 1,
        });
        rig.pump();
        rig.words.write(At::Forward(1), word(1, 0, 1));
        let mut bytes = head(1).to_bytes();
        bytes[16..24].copy_from_slice(&len.to_le_bytes());
        rig.heads.insert((1, 0), bytes);
        let ended = NoDelivery::Ended(end(violation!(BadLength, "SM2-RNG-004")));
        let taken = rig.take().map(|it| it.unwrap().len);
        assert_eq!(taken, if expected { Ok(len) } else { Err(ended) });
    }
}

//= SM2-RNG-008 test
#[test]
fn a_back_word_that_was_not_taken_yet() {
    let mut rig = busy(false);
    // Message 2 was given back in the first word, so the second word is next.
    rig.words.write(At::Back(1), 1);
    let ended = Error::Ended(end(violation!(BadWord, "SM2-RNG-008")));
    assert_eq!(rig.release(1), Err(ended));
    assert_over(&mut rig, RECEIVER, violation!(BadWord, "SM2-RNG-008"));
}

/// Each row is a word that the sender finds in place of its own, or where it has put none.
//= SM2-RNG-005 test
#[test]
fn words_that_a_sender_refuses_in_its_place() {
    // Message 5 goes to the index of message 1, which was taken. Message 7 goes to that of message
    // 3, which was not.
    let rows = [
        (5, At::Forward(1), 1),
        (5, At::Forward(1), word(0, 1, 1)), // it was taken: the word is back
        (5, At::Forward(1), word(0, 5, 5)), // the one that comes
        (7, At::Forward(3), 1),
        (7, At::Forward(3), word(0, 3, 3) ^ 1), // another slot
        (7, At::Forward(3), word(0, 3, 7)),
        (7, At::Forward(3), u64::MAX),
    ];
    for (id, at, bits) in rows {
        let mut rig = busy(false);
        let _ = rig.harvest().unwrap();
        rig.settled();
        for id in 4..id {
            let _ = rig.send(id, id as u32).unwrap();
        }
        if at == At::Forward(1) {
            // The sender has not seen yet that message 1 was taken.
            assert_eq!(rig.words.read(at), EMPTY);
        }
        rig.words.write(at, bits);
        let expected = match bits == word(0, 1, 1) {
            // The sender sees message 1 as displaced. That the receiver also gives it back is
            // detected later.
            true => Ok(Wake::NotNeeded),
            false => Err(Error::Ended(end(violation!(BadWord, "SM2-RNG-005")))),
        };
        assert_eq!(rig.send(id, id as u32), expected, "{bits:x}");
        if expected.is_err() {
            assert_over(&mut rig, SENDER, violation!(BadWord, "SM2-RNG-005"));
        } else {
            let _ = rig.release(1).unwrap();
            let ended = Error::Ended(end(violation!(BadWord, "SM2-RNG-008")));
            assert_eq!(rig.harvest(), Err(ended));
        }
        assert_settled_once(&rig);
    }
}

/// A reliable sender with few unreleased messages puts a word without a look at its index, and finds what is there.
//= SM2-RNG-005 test
#[test]
fn a_reliable_sender_finds_a_word_that_the_receiver_put() {
    let mut rig = Rig::open(true, 2, 1);
    rig.words.write(At::Forward(1), word(0, 1, 1));
    let ended = Error::Ended(end(violation!(BadWord, "SM2-RNG-005")));
    assert_eq!(rig.send(1, 1), Err(ended));
}

/// On a reliable link, an index that was read as 0 must stay empty.
//= SM2-RNG-005 test
#[test]
fn a_reliable_sender_gets_nothing() {
    struct Changing<'a>(&'a ring_support::Memory);
    impl sm2_proto::link::RingMemory for Changing<'_> {
        fn load(&self, at: At) -> u64 {
            self.0.read(at)
        }
        fn swap(&self, at: At, bits: u64) -> u64 {
            self.0.write(at, bits);
            word(0, 1, 1)
        }
        fn take(&self, _: At, _: u64) -> bool {
            false
        }
        fn write_cell(&self, index: u32, words: &[u64]) {
            self.0.write_cell(index, words);
        }
        fn read_cell(&self, index: u32, words: &mut [u64]) {
            self.0.read_cell(index, words);
        }
        fn fence(&self) {}
    }
    let mut rig = busy(true);
    let _ = rig.harvest().unwrap();
    let _ = rig.send(4, 4).unwrap();
    let message = sm2_proto::link::OutboundMessage {
        key: 50,
        id: 5,
        time: Instant(0),
        status: Status::Ok,
        len: 0,
        body: Body::Pooled {
            segment: segment(0),
            slot: 5,
        },
    };
    let sent = rig.ends[SENDER].send(&Changing(&rig.words), message.clone(), |_, _| {});
    assert_eq!(
        sent,
        Err(Error::Ended(end(violation!(BadWord, "SM2-RNG-005"))))
    );
    rig.drain(SENDER);
    assert_over(&mut rig, SENDER, violation!(BadWord, "SM2-RNG-005"));
}

//= SM2-RNG-008, SM2-MSG-004 test
#[test]
fn words_that_a_sender_refuses_to_take_back() {
    let rows = [
        1,
        1 << 30,
        word(0, 2, 3),  // a sequence number that is in another slot
        word(0, 9, 2),  // a slot without a message
        word(0, 16, 2), // no slot
        word(1, 2, 2),  // no such segment
        word(32_767, 2, 2),
        word(0, 2, 6),
        u64::MAX,
    ];
    for bits in rows {
        let mut rig = busy(false);
        rig.words.write(At::Back(0), bits);
        let ended = Error::Ended(end(violation!(BadWord, "SM2-RNG-008")));
        assert_eq!(rig.harvest(), Err(ended), "{bits:x}");
        assert_over(&mut rig, SENDER, violation!(BadWord, "SM2-RNG-008"));
        assert_settled_once(&rig);
        assert_eq!(rig.settled.len(), 3);
    }
}

/// One message is given back twice.
//= SM2-RNG-008, SM2-MSG-004 test
#[test]
fn given_back_twice() {
    let mut rig = busy(false);
    rig.words.write(At::Back(1), word(0, 2, 2));
    let ended = Error::Ended(end(violation!(BadWord, "SM2-RNG-008")));
    assert_eq!(rig.harvest(), Err(ended));
    assert_eq!(rig.settled()[0], (20, Fate::Delivered));
    let mut rig = busy(false);
    let _ = rig.harvest().unwrap();
    rig.words.write(At::Back(1), word(0, 2, 2));
    assert_eq!(rig.harvest(), Err(ended), "also later");
}

/// A message is given back while it is still in the ring. The sender sees that when it reuses the
/// index.
//= SM2-RNG-005, SM2-RNG-008 test
#[test]
fn given_back_without_being_taken() {
    let mut rig = busy(false);
    rig.words.write(At::Back(1), word(0, 3, 3));
    let mut verdict = rig.harvest();
    for id in 4..=7 {
        if verdict.is_ok() {
            verdict = rig.send(id, 4 + id as u32);
        }
    }
    let ended = Error::Ended(end(violation!(BadWord, "SM2-RNG-005")));
    assert_eq!(verdict, Err(ended));
    assert_over(&mut rig, SENDER, violation!(BadWord, "SM2-RNG-005"));
    assert_settled_once(&rig);
}

/// A message cannot be given back while it is being sent.
//= SM2-RNG-006, SM2-RNG-008 test
#[test]
fn given_back_before_it_was_put() {
    let mut rig = rig(false);
    for id in 1..=6 {
        let _ = rig.send(id, id as u32).unwrap();
        rig.words.write(At::Forward((id % 4) as u32), EMPTY);
    }
    // The window is full, so the sender looks at the back words.
    rig.words.write(At::Back(0), word(0, 7, 7));
    let ended = Error::Ended(end(violation!(BadWord, "SM2-RNG-008")));
    assert_eq!(rig.send(7, 7), Err(ended));
    let last = rig.settled.iter().filter(|it| it.0 == 70);
    assert_eq!(last.collect::<Vec<_>>(), [&(70, Fate::Closed)]);
    assert_settled_once(&rig);
}

/// A CLOSE with the code of a violation is not a violation by the end that receives it.
//= SM2-OPN-007, SM2-OPN-008 test
#[test]
fn the_other_end_hears_of_it() {
    let mut rig = busy(false);
    rig.words.write(At::Back(0), 1);
    assert!(rig.harvest().is_err());
    assert_eq!(rig.underway(SENDER), [FrameKind::Close]);
    rig.pump();
    let code = Code(ViolationKind::BadWord as u16);
    assert_eq!(code, ViolationKind::BadWord.code());
    assert_eq!(rig.ends[RECEIVER].end(), Some(End::Peer(code)));
    assert_eq!(rig.taken().id, 3, "what was sent before counts");
}
