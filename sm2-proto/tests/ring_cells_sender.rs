//! The sending end's view of messages in cells: SM2-RNG-013.

// Shows RNG-FIFO, RNG-HOSTILE, LNK-FATES (test).

use std::collections::BTreeMap;

use crate::link_support::{NOW, config, opened, with_ring};
use crate::ring_support::noting::{Access, Noting};
use crate::ring_support::{
    RECEIVER, Rig, SENDER, cell, cell_message, content, ring_config, segment, word,
};
use sm2_proto::{
    Farewell, Machine, Period,
    limits::CELL_MAX,
    link::{
        At, CELL_WORDS, Config, Counters, EMPTY, End, Error, Fate, Input, Link, Misuse, NoMemory,
        Payload, Role, Status, Wake,
    },
    violation,
};

const OK: Status = Status::Ok;

fn misuse(of: Misuse) -> Result<Wake, Error> {
    Err(Error::Misuse(of))
}

/// The counters that differ from zero: offered, delivered, discarded, closed, in flight.
pub(super) fn counters([offered, delivered, discarded, closed, in_flight]: [u64; 5]) -> Counters {
    Counters {
        offered,
        delivered,
        discarded,
        closed,
        in_flight,
        ..Counters::default()
    }
}

/// Takes a message that must be in a cell, and compares it with what was sent.
pub(super) fn take_cell(rig: &mut Rig, id: u64) {
    let delivery = rig.taken();
    assert_eq!(delivery.id, id);
    let Payload::Cell(bytes) = delivery.payload else {
        panic!("it is in a slot");
    };
    assert_eq!(*bytes, content(id));
}

/// A message in a cell needs no segment, and the socket carries nothing for it.
//= SM2-RNG-013 test
#[test]
fn the_words_of_a_message_in_a_cell() {
    let mut rig = Rig::fresh(false, 3, 1);
    rig.pump();
    let bytes: Vec<u8> = (1..=11).collect();
    assert!(rig.ends[SENDER].takes_cells(&rig.words));
    assert_eq!(
        rig.send_bytes(&cell_message(4, &bytes)),
        Ok(Wake::NotNeeded)
    );
    // The first message has index 1, and its cell begins at 128 + 128.
    let first = [
        (256, 0x0000_0001_4000_000b),
        (264, 4),
        (272, 104),
        (280, 0x0807_0605_0403_0201),
        (288, 0x000b_0a09),
    ];
    assert_eq!(rig.words.image(), BTreeMap::from(first));
    // The longest one fills its cell, and the shortest one has no payload.
    let longest = [0xff; CELL_MAX];
    let _ = rig.send_bytes(&cell_message(5, &longest)).unwrap();
    let mut words = [0; CELL_WORDS];
    rig.words.read_cell_from(2, 0, &mut words);
    assert_eq!(words[..2], [5, 105]);
    assert_eq!(words[2..], [u64::MAX; 13]);
    let _ = rig.send_bytes(&cell_message(6, &[])).unwrap();
    let expected = [cell(0, OK, 3), cell(11, OK, 1), cell(104, OK, 2)];
    assert_eq!(rig.words.forward(), expected);
    assert_eq!(rig.underway(SENDER), []);
    assert_eq!(rig.settled(), []);
    assert_eq!(rig.ends[SENDER].counters(), counters([3, 0, 0, 0, 3]));
}

/// The sender empties the word before it writes the words behind it, and puts its word last.
//= SM2-RNG-013 test
#[test]
fn a_cell_is_emptied_then_written_then_named() {
    let mut rig = Rig::open(false, 2, 1);
    let mut send = |id| {
        let noting = Noting::new(&rig.words);
        let message = cell_message(id, &[1, 2, 3]);
        let sent = rig.ends[SENDER].send_in_cell(&noting, &message, |_, _| {});
        assert_eq!(sent, Ok(Wake::NotNeeded));
        noting.accesses()
    };
    let at = At::Forward(1);
    let named = |sequence| {
        [
            Access::Write(1, 3),
            Access::Swap(at, cell(3, OK, sequence)),
            Access::Fence,
            Access::Load(At::ReceiverParked),
        ]
    };
    // The sender knows that the first word is empty.
    assert_eq!(send(1), named(1));
    send(2);
    let emptied = [Access::Load(at), Access::Swap(at, EMPTY)];
    // While the ring may be full, the sender looks at the word of the next message.
    let looks = [Access::Load(At::Forward(0))];
    assert_eq!(send(3), [&emptied[..], &named(3), &looks].concat());
    // A message in a slot of the round before is emptied as well.
    let _ = rig.send(4, 4).unwrap();
    rig.words.write(At::Forward(1), EMPTY);
    let _ = rig.send(5, 5).unwrap();
    let _ = rig.send(6, 6).unwrap();
    let noting = Noting::new(&rig.words);
    let message = cell_message(7, &[1, 2, 3]);
    let mut settled = Vec::new();
    let _ = (rig.ends[SENDER])
        .send_in_cell(&noting, &message, |key, fate| settled.push((key, fate)))
        .unwrap();
    let expected = [&emptied[..], &named(7), &looks].concat();
    assert_eq!(noting.accesses(), expected);
    assert_eq!(settled, [(50, Fate::Discarded)]);
}

//= SM2-RNG-013 test
#[test]
fn what_cannot_be_sent_in_a_cell() {
    let mut rig = Rig::open(false, 2, 1);
    let _ = rig.send_bytes(&cell_message(5, &[0; CELL_MAX])).unwrap();
    let before = (rig.ends[SENDER].clone(), rig.words.image());
    let one_more = [0; CELL_MAX + 1];
    assert_eq!(
        rig.send_bytes(&cell_message(6, &one_more)),
        misuse(Misuse::TooLong)
    );
    assert_eq!(rig.send_in_cell(5), misuse(Misuse::IdNotGrowing));
    assert_eq!(rig.send(5, 1), misuse(Misuse::IdNotGrowing));
    assert_eq!((rig.ends[SENDER].clone(), rig.words.image()), before);
    let sent = rig.ends[SENDER].send_in_cell(&NoMemory, &cell_message(6, &[]), |_, _| {});
    assert_eq!(sent, misuse(Misuse::NotLent));
    assert!(!rig.ends[SENDER].takes_cells(&NoMemory));
    let sent = rig.ends[RECEIVER].send_in_cell(&rig.words, &cell_message(6, &[]), |_, _| {});
    assert_eq!(sent, misuse(Misuse::WrongRole));
    assert!(!rig.ends[RECEIVER].takes_cells(&rig.words));
    // A socket that takes no more holds up messages in cells as well.
    rig.ends[SENDER].handle(NOW, Input::Blocked).unwrap();
    assert_eq!(rig.send_in_cell(6), misuse(Misuse::NoRoom));
    assert!(!rig.ends[SENDER].takes_cells(&rig.words));
    rig.input(SENDER, Input::Writable).unwrap();
    assert!(rig.ends[SENDER].takes_cells(&rig.words));
    assert_eq!(rig.send_in_cell(6), Ok(Wake::NotNeeded));
    rig.input(SENDER, Input::Eof).unwrap();
    assert_eq!(rig.send_in_cell(7), Err(Error::Ended(End::Eof)));
    assert!(!rig.ends[SENDER].takes_cells(&rig.words));
}

/// There are no cells on the socket lane, before RING has come, or if messages have a lifespan.
//= SM2-RNG-013 test
#[test]
fn links_without_cells() {
    let send = |link: &mut Link, rig: &Rig| {
        assert!(!link.takes_cells(&rig.words));
        let before = link.clone();
        let sent = link.send_in_cell(&rig.words, &cell_message(1, &[1]), |_, _| {});
        assert!(*link == before && rig.words.image().is_empty());
        sent
    };
    let rig = Rig::open(false, 2, 1);
    let mut socket = opened(config(Role::Sender));
    assert_eq!(send(&mut socket, &rig), misuse(Misuse::NotOpen));
    let mut early = opened(with_ring(Role::Sender));
    assert_eq!(send(&mut early, &rig), misuse(Misuse::NotOpen));
    let expiring = |role| Config {
        lifespan: Period(5),
        lease: Period::NONE,
        ..ring_config(role, false, 2, 1)
    };
    let rig = Rig::with([Role::Sender, Role::Receiver].map(expiring)).opened();
    let mut sender = rig.ends[SENDER].clone();
    assert_eq!(send(&mut sender, &rig), misuse(Misuse::NotPooled));
}

/// A ring of depth n holds the last n messages, whether they are in cells or in slots.
//= SM2-RNG-005, SM2-RNG-013, SM2-QOS-001, SM2-QOS-006 test
#[test]
fn keep_last_is_exact_with_cells() {
    for in_cells in [[true, true], [true, false], [false, true]] {
        let mut rig = Rig::open(false, 2, 1);
        let mut fates = Vec::new();
        for id in 1..=9_u64 {
            let is_cell = |id: u64| in_cells[usize::from(id.is_multiple_of(3))];
            let sent = match is_cell(id) {
                true => rig.send_in_cell(id),
                false => rig.send(id, (id % 4) as u32),
            };
            assert_eq!(sent, Ok(Wake::NotNeeded));
            // Only the fates of messages in slots are passed on, and at once.
            if id > 2 && !is_cell(id - 2) {
                fates.push((10 * (id - 2), Fate::Discarded));
            }
            assert_eq!(rig.settled(), fates);
            fates.clear();
            let discarded = id.saturating_sub(2);
            let expected = counters([id, 0, discarded, 0, id - discarded]);
            assert_eq!(rig.ends[SENDER].counters(), expected);
        }
        let (first, second) = (rig.taken(), rig.taken());
        assert_eq!((first.id, first.sequence, first.lost), (8, 8, 7));
        assert!(matches!(first.payload, Payload::Cell(_)) == in_cells[0]);
        assert_eq!((second.id, second.lost), (9, 0));
        for sequence in [8, 9] {
            let _ = rig.release(sequence);
        }
        let _ = rig.harvest().unwrap();
        assert_eq!(rig.ends[SENDER].counters(), counters([9, 2, 7, 0, 0]));
    }
}

/// On a reliable link nothing is displaced, and taking a message makes room.
//= SM2-RNG-005, SM2-RNG-013, SM2-QOS-002 test
#[test]
fn a_reliable_ring_full_of_cells() {
    let mut rig = Rig::open(true, 2, 1);
    let _ = rig.send_in_cell(1).unwrap();
    let _ = rig.send_in_cell(2).unwrap();
    let before = (rig.words.image(), rig.ends[SENDER].clone());
    assert!(!rig.room());
    assert_eq!(rig.send_in_cell(3), misuse(Misuse::NoRoom));
    assert_eq!(rig.send(3, 3), misuse(Misuse::NoRoom));
    assert_eq!((rig.words.image(), rig.ends[SENDER].clone()), before);
    rig.ends[SENDER].park(&rig.words);
    take_cell(&mut rig, 1);
    assert!(rig.ends[RECEIVER].made_room(&rig.words).is_needed());
    assert!(rig.room());
    // No message in a cell comes back, so the window is never full, and no back word is used.
    for id in 3..40 {
        let _ = rig.send_in_cell(id).unwrap();
        assert!(!rig.room());
        take_cell(&mut rig, id - 1);
        assert_eq!(rig.words.back(), [EMPTY; 3]);
    }
    let _ = rig.harvest().unwrap();
    assert_eq!(rig.ends[SENDER].counters(), counters([39, 38, 0, 0, 1]));
}

/// The window is full of a message that is held, and of cells that were taken.
//= SM2-RNG-006, SM2-RNG-013 test
#[test]
fn taken_cells_do_not_fill_the_window() {
    for reliable in [false, true] {
        let mut rig = Rig::open(reliable, 2, 1);
        let _ = rig.send(1, 1).unwrap();
        assert_eq!(rig.taken().id, 1);
        let _ = rig.send_in_cell(2).unwrap();
        let _ = rig.send_in_cell(3).unwrap();
        take_cell(&mut rig, 2);
        take_cell(&mut rig, 3);
        assert_eq!(rig.ends[SENDER].in_flight(), 3);
        if reliable {
            assert_eq!(
                rig.send_in_cell(4),
                misuse(Misuse::NoRoom),
                "it has not looked"
            );
            let _ = rig.harvest().unwrap();
            assert!(rig.room());
        }
        assert_eq!(rig.send_in_cell(4), Ok(Wake::NotNeeded));
        assert_eq!(rig.ends[SENDER].counters(), counters([4, 2, 0, 0, 2]));
    }
}

/// A link owes until each message that was in flight is settled, also those in cells.
//= SM2-QOS-003, SM2-RNG-013 test
#[test]
fn a_debt_is_paid_by_cells() {
    let mut rig = Rig::open(true, 2, 1);
    let _ = rig.send_in_cell(1).unwrap();
    let _ = rig.send_in_cell(2).unwrap();
    rig.input(SENDER, Input::Drop(Fate::NoRoom)).unwrap();
    for id in [1, 2] {
        assert!(rig.ends[SENDER].owes());
        take_cell(&mut rig, id);
        assert!(rig.ends[SENDER].owes(), "the sender has not seen it");
        let _ = rig.harvest().unwrap();
    }
    assert!(!rig.ends[SENDER].owes());
    // A send pays as well, if it finds that its index was emptied.
    let _ = rig.send_in_cell(3).unwrap();
    rig.input(SENDER, Input::Drop(Fate::NoRoom)).unwrap();
    let _ = rig.send_in_cell(4).unwrap();
    take_cell(&mut rig, 3);
    assert!(rig.ends[SENDER].owes());
    let _ = rig.send_in_cell(5).unwrap();
    assert!(!rig.ends[SENDER].owes());
    // A message in a slot that is held keeps the debt.
    take_cell(&mut rig, 4);
    take_cell(&mut rig, 5);
    let _ = rig.send(6, 6).unwrap();
    let _ = rig.send_in_cell(7).unwrap();
    rig.input(SENDER, Input::Drop(Fate::NoRoom)).unwrap();
    let held = rig.taken();
    take_cell(&mut rig, 7);
    let _ = rig.harvest().unwrap();
    assert!(rig.ends[SENDER].owes());
    let _ = rig.release(held.sequence).unwrap();
    let _ = rig.harvest().unwrap();
    assert!(!rig.ends[SENDER].owes());
    let counters = rig.ends[SENDER].counters();
    assert_eq!((counters.delivered, counters.no_room), (7, 3));
    assert!(counters.is_balanced());
}

/// Messages that were taken before the end count as delivered, and the others as closed.
//= SM2-RNG-010, SM2-RNG-013, SM2-OPN-009, SM2-QOS-006 test
#[test]
fn the_end_settles_cells() {
    for looks in [false, true] {
        let mut rig = Rig::open(false, 4, 2);
        for id in 1..=3 {
            let _ = rig.send_in_cell(id).unwrap();
        }
        let _ = rig.send(4, 4).unwrap();
        take_cell(&mut rig, 1);
        take_cell(&mut rig, 2);
        if looks {
            assert_eq!(rig.settle_returned(), Ok(()));
        }
        let close = Input::Close(Farewell::Done.code());
        rig.input(SENDER, close).unwrap();
        assert_eq!(rig.settled(), [(40, Fate::Closed)], "only those in slots");
        let delivered = if looks { 2 } else { 0 };
        let expected = counters([4, delivered, 0, 4 - delivered, 0]);
        assert_eq!(rig.ends[SENDER].counters(), expected);
        assert_eq!(rig.ends[SENDER].in_flight(), 0);
    }
}

/// Each row is a word that the sender finds in place of that of message 1, which is in a cell.
//= SM2-RNG-005, SM2-RNG-013 test
#[test]
fn words_that_a_sender_refuses_in_place_of_a_cell() {
    let ours = cell(content(1).len(), OK, 1);
    let rows = [
        1,
        1 << 30,
        ours ^ 1,                      // another length
        ours ^ 1 << 8,                 // another status
        cell(content(1).len(), OK, 3), // the next one here
        word(0, 1, 1),                 // in a slot
        u64::MAX,
    ];
    for (bits, in_cell) in rows.into_iter().flat_map(|it| [(it, false), (it, true)]) {
        let mut rig = Rig::open(false, 2, 1);
        let _ = rig.send_in_cell(1).unwrap();
        let _ = rig.send(2, 2).unwrap();
        rig.words.write(At::Forward(1), bits);
        let sent = match in_cell {
            true => rig.send_in_cell(3),
            false => rig.send(3, 3),
        };
        let end = End::Violation(violation!(BadWord, "SM2-RNG-005"));
        assert_eq!(sent, Err(Error::Ended(end)), "{bits:x}");
        assert_eq!(rig.ends[SENDER].counters(), counters([3, 0, 0, 3, 0]));
        let closed: &[u64] = if in_cell { &[20] } else { &[20, 30] };
        let closed: Vec<_> = closed.iter().map(|key| (*key, Fate::Closed)).collect();
        assert_eq!(rig.settled(), closed);
    }
    // On a reliable link the index must be empty.
    let mut rig = Rig::open(true, 2, 1);
    rig.words.write(At::Forward(1), cell(0, OK, 1));
    let end = End::Violation(violation!(BadWord, "SM2-RNG-005"));
    assert_eq!(rig.send_in_cell(1), Err(Error::Ended(end)));
}

/// Messages in cells have no back words.
//= SM2-RNG-008, SM2-RNG-013 test
#[test]
fn a_cell_that_is_given_back() {
    let taken = cell(content(1).len(), OK, 1);
    for bits in [taken, word(0, 1, 1), word(0, 0, 1)] {
        let mut rig = Rig::open(false, 2, 1);
        let _ = rig.send_in_cell(1).unwrap();
        take_cell(&mut rig, 1);
        rig.words.write(At::Back(0), bits);
        let end = End::Violation(violation!(BadWord, "SM2-RNG-008"));
        assert_eq!(rig.harvest(), Err(Error::Ended(end)), "{bits:x}");
        assert_eq!(rig.ends[SENDER].counters(), counters([1, 0, 0, 1, 0]));
    }
}

//= SM2-RNG-012, SM2-RNG-013 test
#[test]
fn a_message_in_a_cell_rings_the_bell() {
    let mut rig = Rig::fresh(true, 2, 1);
    rig.pump();
    rig.ends[RECEIVER].park(&rig.words);
    assert_eq!(rig.send_in_cell(1), Ok(Wake::Needed));
    assert_eq!(rig.send_in_cell(2), Ok(Wake::NotNeeded), "once is enough");
    take_cell(&mut rig, 1);
    assert!(!rig.ends[RECEIVER].made_room(&rig.words).is_needed());
    rig.ends[SENDER].park(&rig.words);
    take_cell(&mut rig, 2);
    assert!(rig.ends[RECEIVER].made_room(&rig.words).is_needed());
    // A message in a cell keeps no segment busy.
    rig.attach(segment(0));
    assert_eq!(rig.send_in_cell(3), Ok(Wake::NotNeeded));
    rig.pump();
    assert_eq!(rig.input(SENDER, Input::Retire { segment: 0 }), Ok(()));
}

//= SM2-RNG-013 test
#[test]
fn the_bits_of_a_word_of_a_cell() {
    assert_eq!(cell(0, Status::Ok, 1), 0x0000_0001_4000_0000);
    assert_eq!(
        cell(104, Status::DeadlinePassed, 0x9_0000_0007),
        0x0000_0007_4000_0368
    );
}
