//! Requests and replies in cells that no correct caller or server sends, and the violation that each
//! causes.

// Shows RNG-HOSTILE (test).

use crate::link_ring_calls::pair;
use crate::link_support::drain;
use crate::ring_calls_words::Between;
use crate::ring_support::calls::{CALLER, Calls, Outcome, SERVER};
use crate::ring_support::{cell, cell_message};
use sm2_proto::{
    Violation,
    limits::CALLS_MAX,
    link::{At, End, Error, LentRing, NoDelivery, Output, Status},
    violation,
};

/// Puts a cell of a peer into the ring that this end takes from.
fn put(pair: &Calls, end: usize, index: u32, bits: u64, id: u64) {
    let words = &pair.world.rings[end];
    words.write_cell_from(index, 0, &[id, 0]);
    words.write(At::Forward(index), bits);
}

fn take(pair: &mut Calls, end: usize) -> Result<Option<u64>, NoDelivery> {
    let (side, world) = pair.side(end);
    let lent = LentRing::new(&world.rings[end], |_| panic!("no head is read"));
    let taken = side.link.take(&lent).map(|it| it.map(|it| it.id));
    side.drain(world);
    taken
}

fn ended(violation: Violation) -> NoDelivery {
    NoDelivery::Ended(End::Violation(violation))
}

/// Each row is the second request that the server finds, after the call with number 1.
//= SM2-RNG-013, SM2-SRV-001 test
#[test]
fn requests_in_cells_that_a_server_refuses() {
    let good = cell(0, Status::Ok, 2);
    let bad = violation!(BadWord, "SM2-RNG-007");
    let rows = [
        (good, 2, None),
        (good, 1, Some(violation!(BadId, "SM2-RNG-013"))),
        (good, 0, Some(violation!(BadId, "SM2-RNG-013"))),
        (
            cell(0, Status::Cancelled, 2),
            2,
            Some(violation!(ReservedNotZero, "SM2-RNG-013")),
        ),
        (good | 105, 2, Some(bad)),
        (cell(0, Status::Ok, 3), 2, Some(bad)),
        (cell(0, Status::Ok, 4), 2, Some(bad)),
    ];
    for (bits, id, expected) in rows {
        let mut pair = pair();
        pair.call_within(None);
        pair.take(SERVER);
        put(&pair, SERVER, 0, bits, id);
        let taken = take(&mut pair, SERVER);
        match expected {
            None => assert_eq!(taken, Ok(Some(id))),
            Some(violation) => {
                assert_eq!(taken, Err(ended(violation)), "{bits:x} {id}");
                assert_eq!(pair.server.link.calls(), 0);
            }
        }
    }
}

/// Each row is the first reply that the caller finds, after the calls 1 and 3.
//= SM2-RNG-013, SM2-RNG-004, SM2-SRV-002 test
#[test]
fn replies_in_cells_that_a_caller_refuses() {
    let rows = [
        (cell(4, Status::Ok, 1), 3, None),
        (cell(0, Status::Cancelled, 1), 1, None),
        (
            cell(0, Status::Ok, 1),
            2,
            Some(violation!(UnknownCall, "SM2-RNG-004")),
        ),
        (
            cell(0, Status::Ok, 1),
            4,
            Some(violation!(UnknownCall, "SM2-RNG-004")),
        ),
        (
            cell(1, Status::Cancelled, 1),
            1,
            Some(violation!(BadLength, "SM2-RNG-004")),
        ),
        (
            0x0000_0001_4000_0400,
            1,
            Some(violation!(BadWord, "SM2-RNG-007")),
        ),
    ];
    for (bits, id, expected) in rows {
        let mut pair = pair();
        pair.call_within(None);
        pair.call_within(None);
        put(&pair, CALLER, 1, bits, id);
        let taken = take(&mut pair, CALLER);
        let Some(violation) = expected else {
            assert_eq!(taken, Ok(Some(id)));
            assert_eq!(pair.caller.link.calls(), 1);
            continue;
        };
        assert_eq!(taken, Err(ended(violation)), "{bits:x} {id}");
        let failed = Some(Outcome::Failed);
        assert!(pair.caller.calls.values().all(|it| *it == failed));
    }
}

/// One request more than the limit of calls without a reply.
//= SM2-SRV-001, SM2-RNG-013 test
#[test]
fn a_caller_without_measure_in_cells() {
    let mut pair = pair();
    for id in 1..=CALLS_MAX as u64 + 1 {
        put(&pair, SERVER, (id % 2) as u32, cell(0, Status::Ok, id), id);
        let taken = take(&mut pair, SERVER);
        if id > CALLS_MAX as u64 {
            let violation = violation!(CallLimit, "SM2-SRV-001");
            assert_eq!(taken, Err(ended(violation)));
        } else {
            assert_eq!(taken, Ok(Some(id)));
        }
    }
}

/// The call whose cell was overwritten fails like all others, and each call fails once.
//= SM2-RNG-005, SM2-RNG-013, SM2-SRV-004 test
#[test]
fn a_server_that_writes_where_the_caller_puts_a_cell() {
    let mut pair = pair();
    pair.call_within(None);
    let words = Between(&pair.world.rings[SERVER]);
    let link = &mut pair.caller.link;
    let sent = link.send_in_cell(&words, &cell_message(9, &[1]), |_, _| {});
    let end = End::Violation(violation!(BadWord, "SM2-RNG-005"));
    assert_eq!(sent, Err(Error::Ended(end)));
    let outputs = drain(link);
    let failed = outputs.iter().filter_map(|it| match it {
        Output::CallFailed { call } => Some(*call),
        _ => None,
    });
    assert_eq!(failed.collect::<Vec<_>>(), [1, 9]);
    let is_settled = |it: &Output| matches!(it, Output::Settled { .. });
    assert!(!outputs.iter().any(is_settled), "no slot becomes free");
    let counters = link.counters();
    assert_eq!((counters.offered, counters.closed), (2, 2));
    assert_eq!(link.in_flight(), 0);
}
