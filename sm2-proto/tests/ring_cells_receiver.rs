//! The receiving end's view of messages in cells: SM2-RNG-013.

// Shows RNG-FIFO, RNG-HOSTILE (test).

use std::cell::{Cell, RefCell};

use crate::ring_support::between::Between;
use crate::ring_support::noting::{Access, Noting};
use crate::ring_support::{
    Memory, RECEIVER, Rig, SENDER, cell, cell_message, content, ring_config, word,
};
use sm2_proto::{
    Code, Farewell, Instant, Newest, Period, Violation,
    limits::CELL_MAX,
    link::{
        At, Config, Delivery, EMPTY, End, Error, Input, LentRing, Link, Misuse, NoDelivery,
        Payload, RingMemory, Role, Status, TooManyBorrowed,
    },
    violation,
};

const OK: Status = Status::Ok;

/// Takes from these words, where no message is in a slot.
fn take(link: &mut Link, words: &impl RingMemory) -> Result<Option<Delivery>, NoDelivery> {
    link.take(&LentRing::new(words, |_| panic!("no head is read")))
}

fn bytes_of(delivery: &Delivery) -> &[u8] {
    match &delivery.payload {
        Payload::Cell(bytes) => bytes,
        other => panic!("it is not in a cell: {other:?}"),
    }
}

fn ended(violation: Violation) -> NoDelivery {
    NoDelivery::Ended(End::Violation(violation))
}

//= SM2-RNG-013, SM2-PAY-006 test
#[test]
fn a_delivery_says_what_the_cell_says() {
    let mut rig = Rig::fresh(false, 2, 1);
    rig.pump();
    let longest: Vec<u8> = (0..CELL_MAX as u8).map(|it| 200 - it).collect();
    for (sequence, len) in (1..).zip([0, 1, 8, 13, 103, CELL_MAX]) {
        let id = 3 * sequence;
        let _ = rig.send_bytes(&cell_message(id, &longest[..len])).unwrap();
        let receiver = &mut rig.ends[RECEIVER];
        assert!(receiver.may_take(&rig.words));
        assert_eq!(receiver.untaken(&rig.words), 1);
        let waits = Newest {
            sequence,
            time: None,
        };
        assert_eq!(receiver.newest(&rig.words), waits);
        let delivery = take(receiver, &rig.words).unwrap().unwrap();
        let expected = (sequence, id, Instant(100 + id), OK, len as u64);
        let Delivery {
            sequence,
            id,
            time,
            status,
            len: its_len,
            ..
        } = delivery;
        assert_eq!((sequence, id, time, status, its_len), expected);
        assert_eq!(delivery.lost, if sequence == 1 { 0 } else { 2 });
        assert_eq!(bytes_of(&delivery), &longest[..len]);
        assert!(!receiver.may_take(&rig.words));
        assert_eq!(receiver.untaken(&rig.words), 0);
        let taken = Newest {
            sequence,
            time: Some(time),
        };
        assert_eq!(receiver.newest(&rig.words), taken);
    }
}

/// The receiver copies the words that the message needs, once, and then takes the word.
//= SM2-RNG-013 test
#[test]
fn a_cell_is_copied_before_its_word_is_taken() {
    let mut rig = Rig::open(false, 2, 1);
    let _ = rig.send_bytes(&cell_message(1, &[1; 9])).unwrap();
    let noting = Noting::new(&rig.words);
    let delivery = take(&mut rig.ends[RECEIVER], &noting).unwrap().unwrap();
    let at = At::Forward(1);
    let expected = [
        Access::Load(at),
        Access::Read(1, 4),
        Access::Take(at, cell(9, OK, 1)),
    ];
    assert_eq!(noting.accesses(), expected);
    // The copy stays as it is when the sender writes the cell again.
    rig.words.write_cell_from(1, 0, &[9; 15]);
    assert_eq!(bytes_of(&delivery), [1; 9]);
    assert_eq!(rig.words.read(at), EMPTY);
}

/// While the receiver copies a message, the sender goes on: it delivers no mixture of two messages.
//= SM2-RNG-013 test
#[test]
fn a_copy_whose_word_was_displaced_is_not_delivered() {
    let mut failed_takes = 0;
    for depth in [1, 2] {
        for (at, sends) in (0..8).flat_map(|at| (1..4).map(move |sends| (at, sends))) {
            let mut rig = Rig::open(false, depth, 1);
            for id in 1..=u64::from(depth) {
                let _ = rig.send_in_cell(id).unwrap();
            }
            let newest = u64::from(depth) + sends;
            let [sender, receiver] = &mut rig.ends;
            let between = Between::new(&rig.words, at, |memory| {
                for id in u64::from(depth) + 1..=newest {
                    let message = content(id);
                    let message = cell_message(id, &message);
                    let _ = sender.send_in_cell(memory, &message, |_, _| {}).unwrap();
                }
                false
            });
            // The first look ends after a bounded number of steps, perhaps with nothing.
            let during = take(receiver, &between).unwrap();
            failed_takes += u32::from(during.as_ref().is_none_or(|it| it.id > 1));
            let after = std::iter::from_fn(|| take(receiver, &rig.words).unwrap());
            let mut last = 0;
            for delivery in during.into_iter().chain(after) {
                assert!(delivery.id > last);
                assert_eq!(bytes_of(&delivery), content(delivery.id), "at {at}");
                assert_eq!(delivery.time, Instant(100 + delivery.id));
                last = delivery.id;
            }
            assert!(last == newest || last == u64::from(depth), "{last} at {at}");
        }
    }
    assert!(failed_takes > 0);
}

/// A sender changes the word between the receiver's copy and its compare-and-exchange.
//= SM2-RNG-013 test
#[test]
fn a_copy_under_another_word_is_not_delivered() {
    let mut rig = Rig::open(false, 2, 1);
    let _ = rig.send_bytes(&cell_message(1, &[1; 8])).unwrap();
    // A load, and the two parts of the copy, come before the compare-and-exchange.
    let between = Between::new(&rig.words, 3, |memory| {
        memory.write_cell_from(1, 1, &[55, 0x0202]);
        memory.write(At::Forward(1), cell(2, OK, 1));
        false
    });
    let delivery = take(&mut rig.ends[RECEIVER], &between).unwrap().unwrap();
    assert_eq!(
        (delivery.time, bytes_of(&delivery)),
        (Instant(55), &[2, 2][..])
    );
    drop(between);
    // A sender that empties the cell and dies there leaves nothing.
    let _ = rig.send_bytes(&cell_message(2, &[1; 8])).unwrap();
    let between = Between::new(&rig.words, 3, |memory| {
        memory.write(At::Forward(0), EMPTY);
        false
    });
    assert_eq!(take(&mut rig.ends[RECEIVER], &between), Ok(None));
    assert_eq!(rig.ends[RECEIVER].end(), None);
}

/// A sender that changes the cell without end costs a bounded number of accesses.
//= SM2-RNG-007, SM2-RNG-013 test
#[test]
fn a_sender_that_always_changes_the_word() {
    struct Restless<'a> {
        memory: &'a Memory,
        accesses: Cell<u32>,
        read: RefCell<Vec<u32>>,
    }
    impl RingMemory for Restless<'_> {
        fn load(&self, at: At) -> u64 {
            self.accesses.set(self.accesses.get() + 1);
            self.memory.read(at)
        }
        fn swap(&self, _: At, _: u64) -> u64 {
            panic!("a receiver takes")
        }
        fn take(&self, _: At, _: u64) -> bool {
            self.accesses.set(self.accesses.get() + 1);
            false
        }
        fn write_cell(&self, _: u32, _: &[u64]) {
            panic!("a receiver takes")
        }
        fn read_cell(&self, index: u32, words: &mut [u64]) {
            self.read.borrow_mut().push(index);
            self.memory.read_cell(index, words);
        }
        fn fence(&self) {}
    }
    let mut rig = Rig::open(false, 2, 1);
    let _ = rig.send_in_cell(1).unwrap();
    let words = Restless {
        memory: &rig.words,
        accesses: Cell::new(0),
        read: RefCell::default(),
    };
    assert_eq!(take(&mut rig.ends[RECEIVER], &words), Ok(None));
    assert_eq!((words.accesses.get(), words.read.take()), (8, vec![1; 4]));
}

/// Each row is a word that the receiver finds in place of that of message 3. The words behind it are
/// those of a good message.
//= SM2-RNG-007, SM2-RNG-013 test
#[test]
fn words_of_cells_that_a_receiver_refuses() {
    let good = cell(8, OK, 3);
    let bad = violation!(BadWord, "SM2-RNG-007");
    let status = violation!(ReservedNotZero, "SM2-RNG-013");
    let mut rows = vec![
        (good, None),
        (cell(0, OK, 3), None),
        (cell(104, OK, 3), None),
        (good - 8 + 105, Some(bad)),   // too long
        (good | 0xff, Some(bad)),      // too long
        (good | 1 << 10, Some(bad)),   // status 4 is unknown
        (good | 1 << 8, Some(status)), // not a reply
        (good | 3 << 8, Some(status)),
        (good ^ 1 << 30, Some(bad)),                 // names nothing
        (cell(8, OK, 2), Some(bad)),                 // of the past
        (cell(8, OK, 4), Some(bad)),                 // the next message, at a wrong index
        (cell(8, OK, (1 << 32) + 3 - 4), Some(bad)), // a round before
        (cell(8, OK, 3 + (1 << 31) + 4), Some(bad)), // further than a sender goes
    ];
    rows.extend((16..30).map(|bit| (good | 1 << bit, Some(bad))));
    for (reliable, (bits, expected)) in rows.iter().flat_map(|it| [(false, it), (true, it)]) {
        let mut rig = Rig::open(reliable, 4, 2);
        for id in 1..=2 {
            let _ = rig.send_in_cell(id).unwrap();
            assert_eq!(rig.taken().id, id);
        }
        rig.put_cell(3, *bits, &[9, 109, 7]);
        let taken = rig.take();
        let Some(violation) = expected else {
            let delivery = taken.unwrap().unwrap();
            assert_eq!((delivery.id, delivery.time), (9, Instant(109)));
            continue;
        };
        assert_eq!(taken, Err(ended(*violation)), "{bits:x} {reliable}");
        assert_eq!(rig.ends[RECEIVER].end(), Some(End::Violation(*violation)));
        assert_eq!(rig.take(), Ok(None), "nothing is taken after a violation");
        rig.pump();
        assert_eq!(rig.ends[SENDER].end(), Some(End::Peer(violation.code())));
    }
    // Only a best-effort sender goes round.
    let mut rig = Rig::open(true, 2, 1);
    rig.put_cell(1, cell(0, OK, 3), &[3, 0]);
    assert_eq!(rig.take(), Err(ended(bad)));
}

/// The ids of messages in cells and in slots grow together.
//= SM2-RNG-013, SM2-MSG-002 test
#[test]
fn ids_of_cells_that_a_receiver_refuses() {
    for in_cell in [false, true] {
        for (id, is_legal) in [
            (0, false),
            (4, false),
            (5, false),
            (6, true),
            (u64::MAX, true),
        ] {
            let mut rig = Rig::open(false, 2, 1);
            let _ = match in_cell {
                true => rig.send_in_cell(5),
                false => rig.send(5, 5),
            };
            assert_eq!(rig.taken().id, 5);
            rig.put_cell(0, cell(0, OK, 2), &[id, 0]);
            match is_legal {
                true => assert_eq!(rig.taken().lost, id - 6),
                false => {
                    let violation = violation!(BadId, "SM2-RNG-013");
                    assert_eq!(rig.take(), Err(ended(violation)), "{id}");
                }
            }
        }
    }
    // A message in a slot is checked against the one in a cell before it.
    let mut rig = Rig::open(false, 2, 1);
    let _ = rig.send_in_cell(5).unwrap();
    assert_eq!(rig.taken().id, 5);
    rig.words.write(At::Forward(0), word(0, 5, 2));
    rig.heads
        .insert((0, 5), crate::ring_support::head(5).to_bytes());
    assert_eq!(rig.take(), Err(ended(violation!(BadId, "SM2-RNG-004"))));
}

/// Messages that can expire are given back, so none of them is in a cell.
//= SM2-RNG-013 test
#[test]
fn no_cells_with_a_lifespan() {
    let config = |role| Config {
        lifespan: Period(5),
        lease: Period::NONE,
        ..ring_config(role, false, 2, 1)
    };
    let mut rig = Rig::with([Role::Sender, Role::Receiver].map(config)).opened();
    rig.put_cell(1, cell(0, OK, 1), &[1, 0]);
    let violation = violation!(BadWord, "SM2-RNG-013");
    assert_eq!(rig.take(), Err(ended(violation)));
    assert_eq!(
        violation.code(),
        Code(sm2_proto::ViolationKind::BadWord as u16)
    );
    assert_eq!(
        rig.words.read(At::Forward(1)),
        cell(0, OK, 1),
        "it is not taken"
    );
}

/// A message in a cell is not given back, and does not count for `max_borrowed`.
//= SM2-RNG-013, SM2-MSG-005 test
#[test]
fn cells_are_not_borrowed() {
    let mut rig = Rig::open(true, 4, 1);
    let _ = rig.send(1, 1).unwrap();
    for id in 2..=3 {
        let _ = rig.send_in_cell(id).unwrap();
    }
    let _ = rig.send(4, 4).unwrap();
    assert_eq!(rig.taken().id, 1);
    // The application holds as many messages as it may.
    for id in 2..=3 {
        assert_eq!(bytes_of(&rig.taken()), content(id));
    }
    let refused = NoDelivery::TooManyBorrowed(TooManyBorrowed { max_borrowed: 1 });
    assert_eq!(rig.take(), Err(refused));
    for sequence in 2..=3 {
        let misuse = Err(Error::Misuse(Misuse::NotBorrowed));
        assert_eq!(rig.release(sequence), misuse);
    }
    assert_eq!(rig.words.back(), [EMPTY; 5]);
    let _ = rig.release(1).unwrap();
    assert_eq!(rig.taken().id, 4);
}

/// Finds the oldest message after the sender went round, and how many are lost.
//= SM2-RNG-007, SM2-RNG-013, SM2-MSG-002 test
#[test]
fn cells_of_a_sender_that_went_round() {
    for depth in [1, 2, 3, 4, 7] {
        for ahead in 0..20_u64 {
            let mut rig = Rig::open(false, depth, 1);
            let depth = u64::from(depth);
            let _ = rig.send_in_cell(1).unwrap();
            assert_eq!(rig.taken().lost, 0);
            for id in 2..2 + ahead {
                let _ = rig.send_in_cell(id).unwrap();
            }
            let left = ahead.min(depth);
            let receiver = &rig.ends[RECEIVER];
            assert_eq!(receiver.untaken(&rig.words) as u64, left);
            assert_eq!(receiver.may_take(&rig.words), left > 0);
            assert_eq!(receiver.newest(&rig.words).sequence, 1 + ahead);
            let mut last = 1;
            for id in 2 + ahead - left..2 + ahead {
                let delivery = rig.taken();
                assert_eq!((delivery.id, delivery.lost), (id, id - last - 1));
                assert_eq!(bytes_of(&delivery), content(id));
                last = id;
            }
            assert_eq!(rig.take(), Ok(None));
        }
    }
}

/// After the end, at most `depth` messages are left, and all of them can be taken at once.
//= SM2-RNG-010, SM2-RNG-013 test
#[test]
fn cells_that_are_left_can_be_taken() {
    for ends_with in 0..3 {
        let mut rig = Rig::open(false, 3, 1);
        for id in 1..=5 {
            let _ = rig.send_in_cell(id).unwrap();
        }
        let close = Input::Close(Farewell::Done.code());
        match ends_with {
            0 => rig.input(RECEIVER, Input::Eof).unwrap(),
            1 => rig.input(RECEIVER, close).unwrap(),
            _ => {
                rig.input(SENDER, close).unwrap();
                rig.pump();
            }
        }
        assert!(rig.ends[RECEIVER].end().is_some());
        for id in 3..=5 {
            assert!(rig.ends[RECEIVER].may_take(&rig.words));
            assert_eq!(bytes_of(&rig.taken()), content(id));
            if ends_with == 0 {
                // A sender that does not know of the end goes on.
                let _ = rig.send_in_cell(id + 3).unwrap();
            }
        }
        assert!(!rig.ends[RECEIVER].may_take(&rig.words));
        assert_eq!(rig.take(), Ok(None));
        if ends_with == 0 {
            // The sender counts them as delivered all the same.
            let _ = rig.harvest().unwrap();
            let counters = rig.ends[SENDER].counters();
            assert_eq!((counters.delivered, counters.discarded), (3, 2));
            assert_eq!(counters.in_flight, 3);
        }
    }
}

/// A sender was killed after it has emptied a cell, in the middle of its next message.
//= SM2-RNG-010, SM2-RNG-013 test
#[test]
fn a_sender_that_died_while_it_wrote_a_cell() {
    let mut rig = Rig::open(false, 3, 1);
    for id in 1..=3 {
        let _ = rig.send_in_cell(id).unwrap();
    }
    // Two accesses empty the cell, and one writes the first half of the words.
    let message = content(4);
    let dying = Between::new(&rig.words, 3, |_| true);
    let mut sender = rig.ends[SENDER].clone();
    let _ = sender.send_in_cell(&dying, &cell_message(4, &message), |_, _| {});
    drop(dying);
    assert_eq!(rig.words.forward()[1], EMPTY);
    assert_eq!(rig.take(), Ok(None), "the sender may still be at it");
    rig.input(RECEIVER, Input::Eof).unwrap();
    assert!(rig.ends[RECEIVER].may_take(&rig.words));
    for (id, lost) in [(2, 1), (3, 0)] {
        let delivery = rig.taken();
        assert_eq!((delivery.id, delivery.lost), (id, lost));
        assert_eq!(bytes_of(&delivery), content(id));
    }
    assert_eq!(rig.take(), Ok(None));
}

/// A wrong cell after the end of the link ends the taking. The reason of the end does not change.
//= SM2-RNG-010, SM2-RNG-013 test
#[test]
fn a_bad_cell_after_the_end() {
    let mut rig = Rig::open(false, 2, 1);
    let _ = rig.send_in_cell(1).unwrap();
    let _ = rig.send_in_cell(2).unwrap();
    rig.input(RECEIVER, Input::Eof).unwrap();
    rig.put_cell(1, cell(0, OK, 1), &[0, 0]);
    assert_eq!(rig.take(), Err(NoDelivery::Ended(End::Eof)));
    assert_eq!(rig.ends[RECEIVER].end(), Some(End::Eof));
    assert_eq!(rig.take(), Ok(None));
}
