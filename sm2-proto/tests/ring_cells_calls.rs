//! Requests and replies in cells: SM2-RNG-013 and SPEC section 9.

// Shows CALL-RING, CALL-CANCEL (test).

use crate::link_ring_calls::{cancel, pair, request};
use crate::link_support::{opened, with_ring};
use crate::ring_support::calls::{CALLER, Outcome, SERVER};
use crate::ring_support::{Memory, cell_message};
use sm2_proto::{
    Violation,
    limits::{CALLS_MAX, CELL_MAX},
    link::{
        At, CellMessage, Counters, End, Error, Input, LentRing, Link, Misuse, NoDelivery, Role,
        Status, Wake,
    },
    violation,
};

fn misuse(of: Misuse) -> Result<Wake, Error> {
    Err(Error::Misuse(of))
}

fn send(link: &mut Link, words: &Memory, id: u64) -> Result<Wake, Error> {
    link.send_in_cell(words, &cell_message(id, &[1]), |_, _| {})
}

fn ended(violation: Violation) -> NoDelivery {
    NoDelivery::Ended(End::Violation(violation))
}

/// Neither needs a segment, and neither is given back: the sockets carry nothing.
//= SM2-RNG-013, SM2-SRV-001, SM2-SRV-002 test
#[test]
fn a_call_and_its_reply_in_cells() {
    let mut pair = pair();
    pair.call_within(None);
    assert_eq!(pair.caller.link.calls(), 1);
    pair.take(SERVER);
    assert_eq!((pair.server.link.calls(), pair.server.taken.len()), (1, 1));
    pair.reply_within(None);
    assert_eq!(pair.server.link.calls(), 0);
    pair.take(CALLER);
    assert_eq!(pair.caller.calls[&1], Some(Outcome::Reply(Status::Ok)));
    assert_eq!(pair.caller.link.calls(), 0);
    assert!(pair.caller.held.is_empty() && pair.server.held.is_empty());
    pair.harvest(CALLER);
    pair.harvest(SERVER);
    for side in [&pair.caller, &pair.server] {
        let once = Counters {
            offered: 1,
            delivered: 1,
            ..Counters::default()
        };
        assert_eq!(side.link.counters(), once);
    }
    assert!(!pair.world.is_readable(CALLER) && !pair.world.is_readable(SERVER));
}

/// Each status is in the word of its reply.
//= SM2-RNG-013, SM2-SRV-002 test
#[test]
fn the_status_of_a_reply_is_in_its_word() {
    for status in Status::ALL {
        for bytes in [&[][..], &[5, 6, 7]] {
            let mut pair = pair();
            pair.call_within(None);
            pair.take(SERVER);
            let reply = CellMessage {
                status,
                ..cell_message(1, bytes)
            };
            let words = &pair.world.rings[CALLER];
            let sent = pair.server.link.send_in_cell(words, &reply, |_, _| {});
            assert_eq!(sent, Ok(Wake::NotNeeded));
            let bits = 0x0000_0001_4000_0000 | (status as u64) << 8 | bytes.len() as u64;
            assert_eq!(words.read(At::Forward(1)), bits);
            let lent = LentRing::new(words, |_| panic!("no head is read"));
            let taken = pair.caller.link.take(&lent);
            if !status.has_payload() && !bytes.is_empty() {
                let violation = violation!(BadLength, "SM2-RNG-004");
                assert_eq!(taken, Err(ended(violation)), "{status:?}");
                continue;
            }
            let delivery = taken.unwrap().unwrap();
            assert_eq!((delivery.id, delivery.status), (1, status));
            assert_eq!((delivery.len, delivery.lost), (bytes.len() as u64, 0));
            assert_eq!(pair.caller.link.calls(), 0);
        }
    }
}

/// A request that finds no room waits in a slot, and none in a cell overtakes it.
//= SM2-RNG-013 test
#[test]
fn no_request_overtakes_those_that_wait() {
    let mut pair = pair();
    // The ring has room for two requests.
    pair.call_within(None);
    pair.call_within(None);
    let words = &pair.world.rings[SERVER];
    let before = (pair.caller.link.clone(), words.image());
    assert_eq!(
        send(&mut pair.caller.link, words, 9),
        misuse(Misuse::NoRoom)
    );
    assert_eq!((pair.caller.link.clone(), words.image()), before);
    assert!(!pair.caller.link.takes_cells(words));
    // This one is for a cell, finds no room, and waits in a slot.
    pair.call_within(None);
    pair.pump();
    pair.harvest(CALLER);
    assert!(pair.caller.link.has_queued());
    pair.take(SERVER);
    pair.take(SERVER);
    // The ring is empty, but the request in the queue comes first.
    let words = &pair.world.rings[SERVER];
    assert!(!pair.caller.link.takes_cells(words));
    assert_eq!(
        send(&mut pair.caller.link, words, 9),
        misuse(Misuse::NoRoom)
    );
    pair.harvest(CALLER);
    assert!(!pair.caller.link.has_queued());
    assert!(pair.caller.link.takes_cells(&pair.world.rings[SERVER]));
    pair.call_within(None);
    pair.take(SERVER);
    pair.take(SERVER);
    assert_eq!(pair.server.taken, [1, 3, 5, 7]);
}

/// The same for replies: their ring has three places.
//= SM2-RNG-013 test
#[test]
fn no_reply_overtakes_those_that_wait() {
    let mut pair = pair();
    for _ in 0..5 {
        pair.call_within(None);
        pair.take(SERVER);
    }
    for _ in 0..4 {
        pair.reply_within(None);
    }
    pair.pump();
    pair.harvest(SERVER);
    assert!(pair.server.link.has_queued());
    pair.take(CALLER);
    let words = &pair.world.rings[CALLER];
    assert_eq!(
        send(&mut pair.server.link, words, 9),
        misuse(Misuse::NoRoom)
    );
    pair.reply_within(None);
    for _ in 0..5 {
        pair.harvest(SERVER);
        pair.take(CALLER);
        pair.release(CALLER);
    }
    assert!(pair.caller.calls.values().all(Option::is_some));
    pair.harvest(SERVER);
    assert_eq!(pair.server.link.in_flight(), 0);
}

//= SM2-RNG-013, SM2-SRV-001, SM2-SRV-002 test
#[test]
fn calls_that_cannot_be_made_in_cells() {
    let mut pair = pair();
    let words = &pair.world.rings[SERVER];
    let link = &mut pair.caller.link;
    let longer = [0; CELL_MAX + 1];
    let before = link.clone();
    let too_long = link.send_in_cell(words, &cell_message(1, &longer), |_, _| {});
    assert_eq!(too_long, misuse(Misuse::TooLong));
    assert!(*link == before, "the call is not made");
    // The ids of requests in cells and in slots grow together.
    assert_eq!(send(link, words, 5), Ok(Wake::NotNeeded));
    assert_eq!(send(link, words, 5), misuse(Misuse::IdNotGrowing));
    let late = link.send(words, request(5, 0), |_, _| {});
    assert_eq!(late, misuse(Misuse::IdNotGrowing));
    let next = link.send(words, request(6, 0), |_, _| {});
    assert_eq!(next, Ok(Wake::NotNeeded));
    assert_eq!(link.calls(), 2);
    // A server replies once to each call that it took.
    let replies = &pair.world.rings[CALLER];
    let link = &mut pair.server.link;
    assert_eq!(send(link, replies, 5), misuse(Misuse::UnknownCall));
    let lent = LentRing::new(words, |_| panic!("no head is read"));
    assert_eq!(link.take(&lent).unwrap().unwrap().id, 5);
    assert_eq!(send(link, replies, 5), Ok(Wake::NotNeeded));
    assert_eq!(send(link, replies, 5), misuse(Misuse::UnknownCall));
    // Before RING arrives, no cell is known.
    for role in [Role::Caller, Role::Server] {
        let mut early = opened(with_ring(role));
        assert_eq!(send(&mut early, replies, 1), misuse(Misuse::NotOpen));
        assert!(!early.takes_cells(replies));
    }
}

//= SM2-SRV-001, SM2-RNG-013 test
#[test]
fn no_more_calls_than_the_limit_in_cells() {
    let mut pair = pair();
    let words = &pair.world.rings[SERVER];
    let link = &mut pair.caller.link;
    assert_eq!(send(link, words, 1), Ok(Wake::NotNeeded));
    for id in 2..=CALLS_MAX as u64 {
        let sent = link.send(words, request(id, 0), |_, _| {});
        assert_eq!(sent, Ok(Wake::NotNeeded));
    }
    assert_eq!(send(link, words, 2000), misuse(Misuse::CallLimit));
    assert_eq!(link.calls(), CALLS_MAX);
}

/// CANCEL comes before or after its request, which is in a cell.
//= SM2-RNG-011, SM2-RNG-013, SM2-SRV-003 test
#[test]
fn a_cancel_of_a_request_in_a_cell() {
    for is_first in [false, true] {
        let mut pair = pair();
        pair.call_within(None);
        if !is_first {
            pair.take(SERVER);
        }
        pair.caller.cancel(&pair.world, 0);
        pair.pump();
        assert_eq!(pair.server.cancelled.contains(&1), !is_first);
        if is_first {
            pair.take(SERVER);
        }
        assert!(pair.server.cancelled.contains(&1));
        let twice = End::Violation(violation!(BadCancel, "SM2-RNG-011"));
        assert_eq!(cancel(&mut pair, 1), Err(Error::Ended(twice)));
    }
}

/// The reply in a cell is taken before the server reads the CANCEL.
//= SM2-RNG-011, SM2-RNG-013 test
#[test]
fn a_cancel_that_is_overtaken_by_a_reply_in_a_cell() {
    for taken in [false, true] {
        let mut pair = pair();
        pair.call_within(None);
        pair.take(SERVER);
        pair.caller.cancel(&pair.world, 0);
        pair.reply_within(None);
        if taken {
            pair.take(CALLER);
            pair.harvest(SERVER);
        }
        pair.pump();
        assert_eq!(pair.end_of(SERVER), None);
        assert!(pair.server.cancelled.is_empty());
        pair.take(CALLER);
        // No CANCEL follows the reply.
        pair.caller.cancel(&pair.world, 0);
        assert!(!pair.world.is_readable(SERVER));
    }
}

/// A reply in a cell was there before the end, and so counts as received.
//= SM2-RNG-010, SM2-RNG-013, SM2-SRV-004 test
#[test]
fn a_reply_in_a_cell_has_come() {
    let mut pair = pair();
    for _ in 0..2 {
        pair.call_within(None);
        pair.take(SERVER);
    }
    pair.reply_within(None);
    pair.server.close(&pair.world, Input::Eof);
    while pair.caller.link.end().is_none() {
        pair.read(CALLER);
    }
    pair.take(CALLER);
    assert_eq!(pair.caller.calls[&1], Some(Outcome::Reply(Status::Ok)));
    pair.take(CALLER);
    assert_eq!(pair.caller.calls[&3], Some(Outcome::Failed));
    assert_eq!(pair.caller.link.calls(), 0);
}

/// After the caller has gone, a request that is left in a cell can be taken, but is no open call.
//= SM2-RNG-010, SM2-RNG-013 test
#[test]
fn a_request_in_a_cell_when_the_caller_went() {
    let mut pair = pair();
    pair.call_within(None);
    pair.call();
    pair.caller.close(&pair.world, Input::Eof);
    let counters = pair.caller.link.counters();
    assert_eq!((counters.offered, counters.closed), (2, 2));
    assert_eq!(pair.caller.link.in_flight(), 0);
    while pair.server.link.end().is_none() {
        pair.read(SERVER);
    }
    pair.take(SERVER);
    assert_eq!(pair.server.taken, [1]);
    assert_eq!((pair.server.link.calls(), pair.server.owed.len()), (0, 0));
}

/// A parked end is woken by a request or a reply in a cell, and a caller that waits for room by a
/// server that takes one.
//= SM2-RNG-012, SM2-RNG-013 test
#[test]
fn cells_wake_both_ends_of_a_service() {
    let mut pair = pair();
    pair.server.link.park(&pair.world.rings[SERVER]);
    pair.call_within(None);
    assert!(pair.world.is_readable(SERVER));
    pair.pump();
    pair.take(SERVER);
    pair.caller.link.park(&pair.world.rings[CALLER]);
    pair.reply_within(None);
    assert!(pair.world.is_readable(CALLER));
    pair.pump();
    pair.take(CALLER);
    assert_eq!(pair.caller.calls[&1], Some(Outcome::Reply(Status::Ok)));
    for _ in 0..3 {
        pair.call_within(None);
    }
    pair.pump();
    pair.harvest(CALLER);
    assert!(pair.caller.link.has_queued());
    assert_eq!(pair.world.rings[SERVER].read(At::SenderParked), 1);
    pair.take(SERVER);
    assert!(pair.world.is_readable(CALLER));
}
