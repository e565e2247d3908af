//! When the sender settles messages in cells: SM2-RNG-013.

// Shows LNK-FATES (test).

use crate::ring_cells_sender::{counters, take_cell};
use crate::ring_support::noting::{Access, Noting};
use crate::ring_support::{Rig, SENDER, cell_message};
use sm2_proto::{
    link::{At, EMPTY, End, Error, Fate},
    violation,
};

/// A message in a cell is settled as delivered by each of the events that SM2-RNG-013 names.
//= SM2-RNG-013 test
#[test]
fn a_taken_message_is_settled_once_the_sender_sees_it() {
    for event in 0..4 {
        let mut rig = Rig::open(false, 1, 1);
        let _ = rig.send_in_cell(1).unwrap();
        take_cell(&mut rig, 1);
        assert_eq!(rig.ends[SENDER].counters(), counters([1, 0, 0, 0, 1]));
        let offered = match event {
            0 => rig.send(2, 2).map(|_| 2),
            1 => rig.send_in_cell(2).map(|_| 2),
            2 => rig.harvest().map(|_| 1),
            _ => rig.settle_returned().map(|()| 1),
        };
        let offered = offered.unwrap();
        let expected = counters([offered, 1, 0, 0, offered - 1]);
        assert_eq!(rig.ends[SENDER].counters(), expected);
        assert_eq!(rig.settled(), []);
        // It is settled once.
        let _ = rig.harvest().unwrap();
        assert_eq!(rig.ends[SENDER].counters(), expected);
    }
}

/// The sender looks at its messages in their order, and stops at one that is in the ring.
//= SM2-RNG-013 test
#[test]
fn cells_are_settled_in_order() {
    let mut rig = Rig::open(false, 4, 2);
    let _ = rig.send_in_cell(1).unwrap();
    let _ = rig.send(2, 2).unwrap();
    let _ = rig.send_in_cell(3).unwrap();
    let _ = rig.send_in_cell(4).unwrap();
    take_cell(&mut rig, 1);
    // No honest receiver takes the message 3 before the message 2.
    let third = rig.words.forward()[3];
    rig.words.write(At::Forward(3), EMPTY);
    let _ = rig.harvest().unwrap();
    assert_eq!(rig.ends[SENDER].counters(), counters([4, 1, 0, 0, 3]));
    rig.words.write(At::Forward(3), third);
    // A message in a slot in between is settled by its back word.
    assert_eq!(rig.taken().id, 2);
    take_cell(&mut rig, 3);
    let _ = rig.harvest().unwrap();
    assert_eq!(rig.ends[SENDER].counters(), counters([4, 2, 0, 0, 2]));
    assert_eq!(rig.settled(), []);
    take_cell(&mut rig, 4);
    let mut keys = Vec::new();
    rig.ends[SENDER].in_flight_keys(|key| keys.push(key));
    assert_eq!(keys, [20], "messages in cells have no keys");
    let _ = rig.release(2).unwrap();
    let _ = rig.harvest().unwrap();
    assert_eq!(rig.settled(), [(20, Fate::Delivered)]);
    assert_eq!(rig.ends[SENDER].counters(), counters([4, 4, 0, 0, 0]));
}

/// If the newest message was taken, so were all before it: one look settles them.
//= SM2-RNG-013 test
#[test]
fn the_newest_cell_shows_that_all_were_taken() {
    for reliable in [false, true] {
        let mut rig = Rig::open(reliable, 8, 2);
        for id in 1..=5 {
            let _ = rig.send_in_cell(id).unwrap();
        }
        (1..=5).for_each(|id| take_cell(&mut rig, id));
        let noting = Noting::new(&rig.words);
        let _ = rig.ends[SENDER].harvest(&noting, |_, _| {}).unwrap();
        let looks = [Access::Load(At::Back(0)), Access::Load(At::Forward(5))];
        assert_eq!(noting.accesses(), looks);
        assert_eq!(rig.ends[SENDER].counters(), counters([5, 5, 0, 0, 0]));
        // Their cells are filled again without a look.
        let noting = Noting::new(&rig.words);
        let message = cell_message(6, &[]);
        let _ = (rig.ends[SENDER])
            .send_in_cell(&noting, &message, |_, _| {})
            .unwrap();
        assert_eq!(noting.accesses()[0], Access::Write(6, 2));
    }
}

/// A receiver that fills a cell again whose message is settled breaks SM2-RNG-005.
//= SM2-RNG-005, SM2-RNG-013 test
#[test]
fn a_settled_message_is_not_displaced() {
    for in_cell in [false, true] {
        let mut rig = Rig::open(false, 1, 1);
        let _ = rig.send_in_cell(1).unwrap();
        let word = rig.words.forward()[0];
        take_cell(&mut rig, 1);
        let _ = rig.harvest().unwrap();
        rig.words.write(At::Forward(0), word);
        let sent = match in_cell {
            true => rig.send_in_cell(2),
            false => rig.send(2, 2),
        };
        let end = End::Violation(violation!(BadWord, "SM2-RNG-005"));
        assert_eq!(sent, Err(Error::Ended(end)));
        assert_eq!(rig.ends[SENDER].counters(), counters([2, 1, 0, 1, 0]));
    }
}
