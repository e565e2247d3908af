//! The sending end's view of messages on the ring lane: SPEC section 8.5.

// Shows RNG-FIFO, RNG-HOSTILE, RNG-WAKE (test).

use crate::link_support::{NOW, ring_file};
use crate::ring_support::{RECEIVER, Rig, SENDER, segment, word};
use sm2_proto::{
    Datagram, Farewell, Instant, Machine,
    limits::MESSAGE_MAX,
    link::{
        At, Body, EMPTY, End, Error, Fate, FrameKind, Input, Misuse, OutboundMessage, Output,
        SegmentInfo, Status, Wake, wire::Frame,
    },
    violation,
};

const D: Fate = Fate::Discarded;

//= SM2-RNG-003, SM2-RNG-005 test
#[test]
fn a_word_is_put_at_its_index() {
    let mut rig = Rig::open(false, 3, 1);
    for (id, slot) in [(1, 4), (2, 2), (3, 0)] {
        assert_eq!(rig.send(id, slot), Ok(Wake::NotNeeded));
    }
    assert_eq!(
        rig.words.forward(),
        [word(0, 0, 3), word(0, 4, 1), word(0, 2, 2)]
    );
    assert_eq!(rig.settled(), []);
    assert_eq!(rig.ends[SENDER].in_flight(), 3);
}

/// A ring of depth n holds the last n messages. Each displaced message is settled once, and its
/// slot is free.
//= SM2-RNG-005, SM2-QOS-001, SM2-QOS-006 test
#[test]
fn keep_last_is_exact() {
    let mut rig = Rig::open(false, 2, 1);
    for id in 1..=2 {
        let _ = rig.send(id, id as u32).unwrap();
    }
    assert!(!rig.room(), "one more would displace one");
    assert_eq!(rig.send(3, 1), Err(Error::Misuse(Misuse::SlotBusy)));
    for id in 3..=9 {
        // Sending the last message has freed the slot of the message before it.
        let _ = rig.send(id, id as u32 % 3).unwrap();
        assert_eq!(rig.settled(), [(10 * (id - 2), D)]);
    }
    let taken: Vec<u64> = (0..2)
        .map(|_| {
            let delivery = rig.taken();
            let _ = rig.release(delivery.sequence).unwrap();
            delivery.id
        })
        .collect();
    assert_eq!(taken, [8, 9]);
    assert_eq!(rig.take(), Ok(None));
    let _ = rig.harvest().unwrap();
    assert_eq!(
        rig.settled(),
        [(80, Fate::Delivered), (90, Fate::Delivered)]
    );
    let counters = rig.ends[SENDER].counters();
    assert_eq!((counters.offered, counters.discarded), (9, 7));
    assert_eq!((counters.delivered, counters.in_flight), (2, 0));
}

//= SM2-RNG-006, SM2-MSG-003 test
#[test]
fn a_full_window_takes_the_oldest_out_before_it_puts_the_next() {
    let mut rig = Rig::open(false, 2, 2);
    for id in 1..=4 {
        let _ = rig.send(id, id as u32).unwrap();
        if id <= 2 {
            rig.taken();
        }
    }
    // Two messages are held and two are in the ring, so the window of four is full.
    assert_eq!(rig.ends[SENDER].in_flight(), 4);
    assert!(!rig.room());
    let _ = rig.send(5, 5).unwrap();
    assert_eq!(rig.settled(), [(30, D)]);
    assert_eq!(rig.ends[SENDER].in_flight(), 4);
    assert_eq!(rig.words.forward(), [word(0, 4, 4), word(0, 5, 5)]);
    // `send` finds messages that were given back, without a call of `harvest`.
    let _ = rig.release(1).unwrap();
    let _ = rig.send(6, 6).unwrap();
    assert_eq!(rig.settled(), [(40, D), (10, Fate::Delivered)]);
    assert_eq!(rig.ends[SENDER].in_flight(), 3);
}

/// The receiver holds more messages than its `max_borrowed` allows.
//= SM2-RNG-006, SM2-MSG-005 test
#[test]
fn a_receiver_that_holds_the_window_is_found() {
    let mut rig = Rig::open(false, 2, 1);
    for id in 1..=3 {
        let _ = rig.send(id, id as u32).unwrap();
        rig.words.write(At::Forward((id % 2) as u32), EMPTY);
    }
    let end = End::Violation(violation!(WindowExceeded, "SM2-RNG-006"));
    assert_eq!(rig.send(4, 4), Err(Error::Ended(end)));
    assert_eq!(rig.outputs[SENDER].last(), Some(&Output::Ended(end)));
    assert_eq!(rig.underway(SENDER), [FrameKind::Close]);
    // Every message given to the link is settled, including the one that it could not send.
    let closed = [1, 2, 3, 4].map(|id| (10 * id, Fate::Closed));
    assert_eq!(rig.settled(), closed);
    let counters = rig.ends[SENDER].counters();
    assert_eq!((counters.offered, counters.closed), (4, 4));
}

//= SM2-RNG-005, SM2-QOS-002 test
#[test]
fn reliable_never_displaces() {
    let mut rig = Rig::open(true, 2, 1);
    let _ = rig.send(1, 1).unwrap();
    let _ = rig.send(2, 2).unwrap();
    let before = rig.words.forward();
    assert!(!rig.room());
    assert_eq!(rig.send(3, 3), Err(Error::Misuse(Misuse::NoRoom)));
    assert_eq!(rig.words.forward(), before, "nothing was put");
    // The receiver has taken one message, so there is room within the window.
    let first = rig.taken();
    assert!(rig.room());
    let _ = rig.send(3, 3).unwrap();
    assert!(!rig.room());
    let _ = rig.release(first.sequence).unwrap();
    rig.taken();
    // An index is free, but the window stays full until the sender harvests the messages given
    // back.
    assert!(!rig.room());
    assert_eq!(rig.send(4, 4), Err(Error::Misuse(Misuse::NoRoom)));
    let _ = rig.harvest().unwrap();
    assert_eq!(rig.settled(), [(10, Fate::Delivered)]);
    assert!(rig.room());
    let _ = rig.send(4, 4).unwrap();
    assert_eq!(rig.ends[SENDER].counters().discarded, 0);
}

/// A message whose sender gave up waiting is counted, and the link owes until that message is
/// given back.
//= SM2-QOS-002, SM2-QOS-006 test
#[test]
fn a_deadline_that_passed() {
    let mut rig = Rig::open(true, 1, 1);
    let _ = rig.send(1, 1).unwrap();
    rig.input(SENDER, Input::Drop(Fate::NoRoom)).unwrap();
    rig.ends[SENDER]
        .handle(NOW, Input::Drop(Fate::Overwritten))
        .unwrap();
    assert!(rig.ends[SENDER].owes());
    let delivery = rig.taken();
    let _ = rig.harvest().unwrap();
    assert!(rig.ends[SENDER].owes());
    let _ = rig.release(delivery.sequence).unwrap();
    let _ = rig.harvest().unwrap();
    assert!(!rig.ends[SENDER].owes());
    let counters = rig.ends[SENDER].counters();
    assert_eq!((counters.offered, counters.no_room), (3, 1));
    assert_eq!((counters.overwritten, counters.delivered), (1, 1));
}

/// A publication that the pool limit keeps from the link is counted, and the link owes until
/// that message is given back.
//= SM2-QOS-007 test
#[test]
fn a_publication_that_the_pool_limit_drops() {
    let mut rig = Rig::open(true, 2, 1);
    let _ = rig.send(1, 1).unwrap();
    rig.input(SENDER, Input::Drop(Fate::PoolLimit)).unwrap();
    let delivery = rig.taken();
    assert!(rig.ends[SENDER].owes());
    let _ = rig.release(delivery.sequence).unwrap();
    let _ = rig.harvest().unwrap();
    assert!(!rig.ends[SENDER].owes());
    let counters = rig.ends[SENDER].counters();
    assert_eq!((counters.offered, counters.pool_limit), (2, 1));
    assert_eq!((counters.dropped(), counters.delivered), (1, 1));
}

//= SM2-RNG-008, SM2-MSG-004 test
#[test]
fn messages_come_back_in_any_order() {
    let mut rig = Rig::open(true, 3, 3);
    for id in 1..=3 {
        let _ = rig.send(id, id as u32).unwrap();
        rig.taken();
    }
    for sequence in [2, 3, 1] {
        assert_eq!(rig.release(sequence), Ok(Wake::NotNeeded));
    }
    let again = Err(Error::Misuse(Misuse::NotBorrowed));
    assert_eq!(rig.release(2), again, "each once");
    let back = rig.words.back();
    assert_eq!(back[..3], [word(0, 2, 2), word(0, 3, 3), word(0, 1, 1)]);
    let _ = rig.harvest().unwrap();
    let order = [20, 30, 10].map(|key| (key, Fate::Delivered));
    assert_eq!(rig.settled(), order);
    assert_eq!(rig.words.back(), [EMPTY; 6]);
    // The receiver gives the next message back in the fourth word.
    let _ = rig.send(4, 2).unwrap();
    rig.taken();
    let _ = rig.release(4).unwrap();
    assert_eq!(rig.words.back()[3], word(0, 2, 4));
}

//= SM2-RNG-012 test
#[test]
fn the_bell_rings_once_for_who_is_parked() {
    let mut rig = Rig::open(true, 2, 1);
    assert_eq!(rig.send(1, 1), Ok(Wake::NotNeeded), "nobody is parked");
    let delivery = rig.taken();
    rig.ends[RECEIVER].park(&rig.words);
    assert_eq!(rig.words.read(At::ReceiverParked), 1);
    assert_eq!(rig.send(2, 2), Ok(Wake::Needed));
    assert_eq!(rig.words.read(At::ReceiverParked), 0);
    assert_eq!(rig.send(3, 3), Ok(Wake::NotNeeded), "once is enough");
    rig.ends[RECEIVER].park(&rig.words);
    rig.ends[RECEIVER].unpark(&rig.words);
    assert_eq!(rig.words.read(At::ReceiverParked), 0);
    rig.ends[SENDER].park(&rig.words);
    assert_eq!(rig.words.read(At::SenderParked), 1);
    assert_eq!(rig.release(delivery.sequence), Ok(Wake::Needed));
    assert_eq!(rig.words.read(At::SenderParked), 0);
    rig.ends[SENDER].park(&rig.words);
    rig.taken();
    assert!(rig.ends[RECEIVER].made_room(&rig.words).is_needed());
    assert!(!rig.ends[RECEIVER].made_room(&rig.words).is_needed());
    // A value other than 1 is cleared, but does not request a wake-up.
    rig.words.write(At::SenderParked, 2);
    assert_eq!(rig.release(2), Ok(Wake::NotNeeded));
    assert_eq!(rig.words.read(At::SenderParked), 0);
    assert!(
        !rig.ends[SENDER].made_room(&rig.words).is_needed(),
        "not its part"
    );
    // The doorbell frame itself changes no state.
    for end in [SENDER, RECEIVER] {
        let before = rig.ends[end].clone();
        rig.frame(end, &Frame::Doorbell, &[]);
        assert_eq!(rig.ends[end], before);
    }
}

/// Messages that are given back together are one batch: the parked word is read once, after the last
/// of them.
//= SM2-RNG-012 test
#[test]
fn a_batch_rings_the_bell_once() {
    let mut rig = Rig::open(false, 3, 3);
    for (id, slot) in [(1, 1), (2, 2), (3, 3)] {
        let _ = rig.send(id, slot).unwrap();
        rig.taken();
    }
    rig.words.take_accesses();
    assert_eq!(rig.release_all([]), Ok(Wake::NotNeeded));
    assert_eq!(rig.words.take_accesses(), 1, "the parked word");
    rig.ends[SENDER].park(&rig.words);
    rig.words.take_accesses();
    assert_eq!(rig.release_all([2, 1]), Ok(Wake::Needed));
    assert_eq!(rig.words.take_accesses(), 4, "two words, and the bell");
    assert_eq!(rig.words.back()[..2], [word(0, 2, 2), word(0, 1, 1)]);
    let not_borrowed = Err(Error::Misuse(Misuse::NotBorrowed));
    assert_eq!(rig.release_all([1, 3]), not_borrowed);
    assert_eq!(rig.words.back()[2], word(0, 3, 3), "all the same");
}

/// A sender with few unreleased messages knows that the next word is free, and leaves it to the receiver's core.
//= SM2-RNG-005 test
#[test]
fn a_sender_with_few_unreleased_messages_does_not_look_for_room() {
    let mut rig = Rig::open(true, 2, 1);
    let _ = rig.send(1, 1).unwrap();
    rig.words.take_accesses();
    assert!(rig.room());
    assert_eq!(rig.words.take_accesses(), 0, "one of two words is used");
    let _ = rig.send(2, 2).unwrap();
    rig.taken();
    rig.words.take_accesses();
    assert!(rig.room());
    assert_eq!(
        rig.words.take_accesses(),
        1,
        "it reads that word 0 was taken"
    );
}

/// Taking a message never wakes a best-effort sender, which displaces messages instead of waiting
/// for room.
//= SM2-RNG-012 test
#[test]
fn only_reliable_links_tell_of_room() {
    let mut rig = Rig::open(false, 1, 1);
    let _ = rig.send(1, 1).unwrap();
    rig.ends[SENDER].park(&rig.words);
    rig.taken();
    assert!(!rig.ends[RECEIVER].made_room(&rig.words).is_needed());
    assert_eq!(rig.words.read(At::SenderParked), 1);
}

//= SM2-RNG-009, SM2-SEG-005 test
#[test]
fn a_number_is_used_again_after_detached() {
    let mut rig = Rig::open(false, 2, 1);
    let _ = rig.send(1, 1).unwrap();
    let retire = Input::Retire { segment: 0 };
    let busy = Err(Error::Misuse(Misuse::SegmentBusy));
    assert_eq!(rig.input(SENDER, retire.clone()), busy);
    let delivery = rig.taken();
    let _ = rig.release(delivery.sequence).unwrap();
    assert_eq!(rig.input(SENDER, retire.clone()), busy, "not seen yet");
    let _ = rig.harvest().unwrap();
    rig.input(SENDER, retire.clone()).unwrap();
    rig.input(SENDER, retire).unwrap();
    assert_eq!(rig.underway(SENDER), [FrameKind::Detach]);
    let again = SegmentInfo {
        slots: 2,
        ..segment(0)
    };
    assert_eq!(rig.input(SENDER, Input::Attach(again)), busy);
    let not_attached = Err(Error::Misuse(Misuse::NotAttached));
    assert_eq!(rig.send(2, 1), not_attached);
    rig.carry(SENDER);
    let detach = Output::Detach { segment: 0 };
    assert_eq!(rig.outputs[RECEIVER].last(), Some(&detach));
    assert_eq!(rig.underway(RECEIVER), [FrameKind::Detached]);
    rig.carry(RECEIVER);
    rig.attach(again);
    rig.pump();
    let _ = rig.send_in(again, 2, 1).unwrap();
    assert_eq!(rig.taken().id, 2);
}

/// A segment that is retired before it was announced still sends its frames in order: ATTACH,
/// DETACH, DETACHED.
//= SM2-RNG-009 test
#[test]
fn retired_before_it_was_announced() {
    let mut rig = Rig::open(false, 2, 1);
    rig.ends[SENDER].handle(NOW, Input::Blocked).unwrap();
    rig.attach(segment(1));
    rig.input(SENDER, Input::Retire { segment: 1 }).unwrap();
    rig.input(SENDER, Input::Writable).unwrap();
    assert_eq!(rig.underway(SENDER), [FrameKind::Attach, FrameKind::Detach]);
    rig.pump();
    assert!(rig.ends.iter().all(|it| it.end().is_none()));
}

/// At most 256 segments exist at a time, including those whose DETACHED has not arrived.
//= SM2-SEG-004, SM2-RNG-009 test
#[test]
fn no_more_segments_than_the_limit() {
    let mut rig = Rig::open(false, 2, 1);
    for id in 1..256 {
        rig.attach(segment(id));
    }
    rig.pump();
    let _ = rig.send(1, 0).unwrap();
    // A segment that holds no message is detached to make room, and the 257th waits for that.
    rig.attach(segment(256));
    assert_eq!(rig.underway(SENDER), [FrameKind::Detach]);
    rig.attach(segment(256));
    assert_eq!(rig.underway(SENDER), [FrameKind::Detach], "one is enough");
    let waits = Err(Error::Misuse(Misuse::NotAttached));
    assert_eq!(rig.send_in(segment(256), 2, 0), waits);
    rig.pump();
    rig.attach(segment(256));
    rig.pump();
    let _ = rig.send_in(segment(256), 2, 0).unwrap();
    assert!(rig.ends.iter().all(|it| it.end().is_none()));
}

/// A segment can be larger than the greatest message.
//= SM2-PAY-008, SM2-RNG-003 test
#[test]
fn a_message_has_the_length_that_a_receiver_takes() {
    let mut rig = Rig::open(false, 2, 1);
    let huge = SegmentInfo {
        id: 1,
        stride: 2 * MESSAGE_MAX,
        slots: 1,
    };
    rig.attach(huge);
    let message = |len, segment| OutboundMessage {
        key: 1,
        id: 1,
        time: Instant(0),
        status: Status::Ok,
        len,
        body: Body::Pooled { segment, slot: 0 },
    };
    let mut send =
        |len, segment| rig.ends[SENDER].send(&rig.words, message(len, segment), |_, _| {});
    let too_long = Err(Error::Misuse(Misuse::TooLong));
    assert_eq!(send(4096 - 63, segment(0)), too_long);
    assert_eq!(send(MESSAGE_MAX + 1, huge), too_long);
    assert_eq!(send(MESSAGE_MAX, huge), Ok(Wake::NotNeeded));
}

#[test]
fn what_cannot_be_sent_changes_nothing() {
    let mut rig = Rig::open(false, 2, 1);
    let _ = rig.send(5, 0).unwrap();
    let before = rig.ends[SENDER].clone();
    rig.words.take_accesses();
    assert_eq!(rig.send(5, 1), Err(Error::Misuse(Misuse::IdNotGrowing)));
    assert_eq!(rig.send(6, 0), Err(Error::Misuse(Misuse::SlotBusy)));
    assert_eq!(rig.send(6, 16), Err(Error::Misuse(Misuse::SlotOutside)));
    let other = SegmentInfo {
        slots: 17,
        ..segment(0)
    };
    assert_eq!(
        rig.send_in(other, 6, 16),
        Err(Error::Misuse(Misuse::SegmentChanged))
    );
    assert_eq!(rig.ends[SENDER], before);
    assert_eq!(rig.words.take_accesses(), 0);
}

//= SM2-OPN-009, SM2-OPN-010, SM2-QOS-006, SM2-RNG-010 test
#[test]
fn the_end_settles_all() {
    let mut rig = Rig::open(false, 2, 1);
    for id in 1..=3 {
        let _ = rig.send(id, id as u32).unwrap();
    }
    assert_eq!(rig.settled(), [(10, D)]);
    rig.input(SENDER, Input::Close(Farewell::Done.code()))
        .unwrap();
    let closed = [20, 30].map(|key| (key, Fate::Closed));
    assert_eq!(rig.settled(), closed);
    let counters = rig.ends[SENDER].counters();
    assert_eq!((counters.offered, counters.discarded), (3, 1));
    assert_eq!((counters.closed, counters.in_flight), (2, 0));
    let end = Error::Ended(End::Local(Farewell::Done.code()));
    assert_eq!(rig.send(4, 4), Err(end));
    assert_eq!(rig.harvest(), Err(end));
    assert!(!rig.room());
}

/// Messages that come back before CLOSE or the end of the stream count as delivered, although no
/// one harvested them before.
//= SM2-QOS-006, SM2-RNG-010 test
#[test]
fn messages_that_came_back_before_the_end_are_delivered() {
    for input in [Some(Farewell::Done.code()), None] {
        let mut rig = Rig::open(false, 4, 2);
        for id in 1..=3 {
            let _ = rig.send(id, id as u32).unwrap();
        }
        for sequence in 1..=2 {
            assert_eq!(rig.taken().sequence, sequence);
            let _ = rig.release(sequence).unwrap();
        }
        assert_eq!(rig.settle_returned(), Ok(()));
        match input {
            Some(code) => {
                let close = Frame::Close(code).to_vec();
                let close = Datagram::new(&close);
                rig.input(SENDER, Input::Datagram(close)).unwrap();
            }
            None => rig.input(SENDER, Input::Eof).unwrap(),
        }
        let returned = [10, 20].map(|key| (key, Fate::Delivered));
        let settled = rig.settled();
        assert_eq!(settled[..2], returned);
        assert_eq!(settled[2..], [(30, Fate::Closed)]);
        let counters = rig.ends[SENDER].counters();
        assert_eq!((counters.delivered, counters.closed), (2, 1));
        assert!(matches!(rig.settle_returned(), Err(Error::Ended(_))));
    }
}

/// A word that is not a message of the link is a violation, also just before the end.
//= SM2-RNG-008 test
#[test]
fn a_false_word_just_before_the_end_is_a_violation() {
    let mut rig = Rig::open(false, 4, 2);
    let _ = rig.send(1, 1).unwrap();
    rig.words.write(At::Back(0), word(0, 9, 9));
    let end = End::Violation(violation!(BadWord, "SM2-RNG-008"));
    assert_eq!(rig.settle_returned(), Err(Error::Ended(end)));
    assert_eq!(rig.settled(), [(10, Fate::Closed)]);
}

/// A new ring must be all zeros. Any other word is a violation by the other end.
//= SM2-RNG-002, SM2-RNG-005 test
#[test]
fn a_ring_begins_with_zeros() {
    let mut rig = Rig::fresh(false, 2, 1);
    rig.words.write(At::Forward(1), word(0, 0, 1));
    rig.pump();
    rig.attach(segment(0));
    rig.pump();
    assert_eq!(rig.outputs[SENDER].len(), 2, "{:?}", ring_file(0));
    let end = End::Violation(violation!(BadWord, "SM2-RNG-005"));
    assert_eq!(rig.send(1, 0), Err(Error::Ended(end)));
}
