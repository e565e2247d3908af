//! Words and frames that no correct caller or server produces, and the violation that each causes.

// Shows CALL-CANCEL, RNG-HOSTILE (test).

use crate::link_support;
use crate::ring_support;

use crate::link_support::{NOW, RING, accept, drain, open_to, opened, with_ring};
use crate::ring_support::calls::{CALLER, Calls, Outcome, SERVER, segment};
use crate::ring_support::{Memory, word};
use sm2_proto::{
    Datagram, Instant, Machine, Violation,
    limits::CALLS_MAX,
    link::{
        At, Body, End, Error, Fate, Input, LentRing, Link, NoDelivery, OutboundMessage, Output,
        RingMemory, Role, Status, Wake, wire::Frame,
    },
    violation,
};

/// The server takes requests with depth 2 and two borrowed. The caller has room for the replies of
/// three calls.
fn pair() -> Calls {
    Calls::open([1, 2], [3, 2])
}

fn cancel(pair: &mut Calls, call: u64) -> Result<(), Error> {
    let bytes = Frame::Cancel { call }.to_vec();
    let result = (pair.server.link).handle(NOW, Input::Datagram(Datagram::new(&bytes)));
    pair.server.drain(&pair.world);
    result
}

fn violation(of: Violation) -> Error {
    Error::Ended(End::Violation(of))
}

//= SM2-RNG-011 test
#[test]
fn cancels_that_no_caller_sends() {
    // Two requests can be in flight.
    let mut twice = pair();
    assert_eq!(cancel(&mut twice, 9), Ok(()));
    assert_eq!(
        cancel(&mut twice, 9),
        Err(violation(violation!(BadCancel, "SM2-RNG-011")))
    );
    let mut many = pair();
    assert_eq!(cancel(&mut many, 9), Ok(()));
    assert_eq!(cancel(&mut many, 2), Ok(()));
    assert_eq!(
        cancel(&mut many, 5),
        Err(violation(violation!(UnknownCall, "SM2-RNG-011")))
    );
    // The server owes the reply to this call.
    let mut owed = pair();
    owed.call();
    owed.take(SERVER);
    assert_eq!(cancel(&mut owed, 1), Ok(()));
    assert!(owed.server.cancelled.contains(&1));
    assert_eq!(
        cancel(&mut owed, 1),
        Err(violation(violation!(BadCancel, "SM2-RNG-011")))
    );
    // A CANCEL for a call that, as the ring shows later, was not made.
    let mut never = pair();
    never.call();
    never.call();
    never.pump();
    never.harvest(CALLER);
    assert_eq!(cancel(&mut never, 2), Ok(()));
    never.take(SERVER);
    let words = &never.world.rings[SERVER];
    let head = |_| Some(head(3, 0, 0));
    let taken = never.server.link.take(&LentRing::new(words, head));
    let end = End::Violation(violation!(UnknownCall, "SM2-RNG-011"));
    assert_eq!(taken, Err(NoDelivery::Ended(end)));
}

/// The head of a slot with this id, length and status.
fn head(id: u64, len: u64, status: u16) -> [u8; 64] {
    let mut bytes = [0; 64];
    bytes[..8].copy_from_slice(&id.to_le_bytes());
    bytes[16..24].copy_from_slice(&len.to_le_bytes());
    bytes[24..26].copy_from_slice(&status.to_le_bytes());
    bytes
}

/// Each row is the second request that the server finds, after the call with number 1.
//= SM2-RNG-004, SM2-SRV-001, SM2-RNG-007 test
#[test]
fn requests_that_a_server_refuses() {
    let good = head(2, 0, 0);
    let mut reserved = good;
    reserved[26] = 1;
    let next = word(0, 3, 2);
    let rows = [
        (next, head(1, 0, 0), violation!(BadId, "SM2-RNG-004")),
        (next, head(0, 0, 0), violation!(BadId, "SM2-RNG-004")),
        (next, head(2, 4033, 0), violation!(BadLength, "SM2-RNG-004")),
        (
            next,
            head(2, 0, 2),
            violation!(ReservedNotZero, "SM2-RNG-004"),
        ),
        (next, reserved, violation!(ReservedNotZero, "SM2-RNG-004")),
        (word(0, 3, 3), good, violation!(BadWord, "SM2-RNG-007")),
        (word(0, 3, 4), good, violation!(BadWord, "SM2-RNG-007")),
        (word(0, 8, 2), good, violation!(BadSlot, "SM2-RNG-007")),
    ];
    for (bits, head, expected) in rows {
        let mut pair = pair();
        pair.call();
        pair.take(SERVER);
        let words = &pair.world.rings[SERVER];
        words.write(At::Forward(0), bits);
        let taken = pair.server.link.take(&LentRing::new(words, |_| Some(head)));
        let end = End::Violation(expected);
        assert_eq!(taken, Err(NoDelivery::Ended(end)), "{bits:x} {head:?}");
        assert_eq!(pair.server.link.calls(), 0);
        assert_eq!(
            pair.server.link.take(&LentRing::new(words, |_| None)),
            Ok(None)
        );
    }
    let mut pair = pair();
    pair.call();
    pair.take(SERVER);
    let words = &pair.world.rings[SERVER];
    words.write(At::Forward(0), next);
    let taken = pair.server.link.take(&LentRing::new(words, |_| Some(good)));
    assert_eq!(taken.unwrap().unwrap().id, 2);
}

/// A ring where a foreign word appears as soon as the caller puts a word.
pub(crate) struct Between<'a>(pub(crate) &'a Memory);

impl RingMemory for Between<'_> {
    fn load(&self, at: At) -> u64 {
        self.0.load(at)
    }

    fn swap(&self, at: At, bits: u64) -> u64 {
        self.0.swap(at, bits);
        word(0, 7, 9)
    }

    fn take(&self, at: At, bits: u64) -> bool {
        self.0.take(at, bits)
    }

    fn write_cell(&self, index: u32, words: &[u64]) {
        self.0.write_cell(index, words);
    }

    fn read_cell(&self, index: u32, words: &mut [u64]) {
        self.0.read_cell(index, words);
    }

    fn fence(&self) {}
}

/// The call whose word was overwritten fails like all others, and each call fails once.
//= SM2-RNG-008, SM2-SRV-004 test
#[test]
fn a_server_that_writes_where_the_caller_does() {
    let mut pair = pair();
    pair.call();
    let words = Between(&pair.world.rings[SERVER]);
    let message = OutboundMessage {
        key: 7,
        id: 9,
        time: Instant(0),
        status: Status::Ok,
        len: 0,
        body: Body::Pooled {
            segment: segment(0),
            slot: 6,
        },
    };
    let link = &mut pair.caller.link;
    let sent = link.send(&words, message.clone(), |_, _| {
        panic!("nothing is settled yet")
    });
    assert_eq!(sent, Err(violation(violation!(BadWord, "SM2-RNG-005"))));
    let outputs = drain(link);
    let settled = |it: &&Output| {
        matches!(
            it,
            Output::Settled {
                fate: Fate::Closed,
                ..
            }
        )
    };
    assert_eq!(outputs.iter().filter(settled).count(), 2, "{outputs:?}");
    assert_eq!(link.in_flight(), 0);
    let counters = link.counters();
    assert_eq!((counters.offered, counters.closed), (2, 2));
}

/// Calls that never reached the ring fail as well.
//= SM2-QOS-006 test
#[test]
fn calls_that_waited_are_closed_by_the_end() {
    let mut pair = pair();
    for _ in 0..4 {
        pair.call();
    }
    assert!(pair.caller.link.has_queued());
    let eof = pair.caller.link.handle(NOW, Input::Eof);
    assert_eq!(eof, Ok(()));
    let counters = pair.caller.link.counters();
    assert_eq!((counters.offered, counters.closed), (4, 4));
}

/// Each row is the first reply that the caller finds, after the calls 1 and 3.
//= SM2-RNG-004, SM2-SRV-002 test
#[test]
fn replies_that_a_caller_refuses() {
    let rows = [
        (head(2, 0, 0), violation!(UnknownCall, "SM2-RNG-004")),
        (head(4, 0, 0), violation!(UnknownCall, "SM2-RNG-004")),
        (head(1, 0, 4), violation!(Malformed, "SM2-RNG-004")),
        (head(1, 0, 256), violation!(Malformed, "SM2-RNG-004")),
        (head(1, 1, 2), violation!(BadLength, "SM2-RNG-004")),
        (head(1, 1, 3), violation!(BadLength, "SM2-RNG-004")),
        (head(1, 4033, 0), violation!(BadLength, "SM2-RNG-004")),
    ];
    let legal = [head(3, 4, 0), head(1, 4, 1), head(3, 0, 2), head(1, 0, 3)];
    let rows = rows.map(|(head, violation)| (head, Some(violation)));
    for (head, expected) in rows.into_iter().chain(legal.map(|it| (it, None))) {
        let mut pair = pair();
        let attach = Frame::Attach(segment(0));
        let fds = link_support::fds_for(&attach);
        link_support::feed(&mut pair.caller.link, &attach.to_vec(), &fds).unwrap();
        pair.call();
        pair.call();
        pair.pump();
        pair.harvest(CALLER);
        let words = &pair.world.rings[CALLER];
        words.write(At::Forward(1), word(0, 2, 1));
        let taken = pair.caller.link.take(&LentRing::new(words, |_| Some(head)));
        pair.caller.drain(&pair.world);
        let Some(expected) = expected else {
            assert!(taken.unwrap().is_some());
            continue;
        };
        let end = End::Violation(expected);
        assert_eq!(taken, Err(NoDelivery::Ended(end)), "{head:?}");
        let failed = Some(Outcome::Failed);
        assert!(
            pair.caller.calls.values().all(|it| *it == failed),
            "at once"
        );
        assert_eq!(pair.caller.outputs.last(), Some(&Output::Ended(end)));
    }
}

/// One request more than the limit of calls without a reply.
//= SM2-SRV-001 test
#[test]
fn a_caller_without_measure() {
    let mut pair = pair();
    pair.call();
    pair.take(SERVER);
    pair.release(SERVER);
    let words = &pair.world.rings[SERVER];
    for id in 2..=CALLS_MAX as u64 + 1 {
        words.write(At::Forward((id % 2) as u32), word(0, 3, id));
        let taken = pair
            .server
            .link
            .take(&LentRing::new(words, |_| Some(head(id, 0, 0))));
        if id > CALLS_MAX as u64 {
            let end = End::Violation(violation!(CallLimit, "SM2-SRV-001"));
            assert_eq!(taken, Err(NoDelivery::Ended(end)));
            break;
        }
        let sequence = taken.unwrap().unwrap().sequence;
        for index in 0..words.layout.window() {
            words.write(At::Back(index), 0);
        }
        assert_eq!(
            pair.server.link.release(words, sequence),
            Ok(Wake::NotNeeded)
        );
    }
    assert!(pair.server.link.end().is_some());
}

/// An end takes nothing from a peer that never hands over a ring.
//= SM2-RNG-002 test
#[test]
fn nothing_is_taken_before_the_other_ring_is_there() {
    let config = with_ring(Role::Server);
    let mut link = opened(config);
    let words = ring_support::Memory::new(config.ring_layout().unwrap());
    accept(&mut link, &Frame::Attach(segment(0)));
    words.write(At::Forward(1), word(0, 0, 1));
    assert!(!link.may_take(&words));
    assert_eq!(
        link.take(&LentRing::new(&words, |_| Some(head(1, 0, 0)))),
        Ok(None)
    );
    accept(&mut link, &RING);
    assert!(link.may_take(&words));
    let taken = link.take(&LentRing::new(&words, |_| Some(head(1, 0, 0))));
    assert_eq!(taken.unwrap().unwrap().id, 1);
}

//= SM2-RNG-002 test
#[test]
fn a_second_ring_is_wrong_at_both_ends() {
    for role in [Role::Caller, Role::Server] {
        let config = with_ring(role);
        let mut link = Link::new(config);
        drain(&mut link);
        accept(&mut link, &open_to(&config));
        accept(&mut link, &RING);
        assert_eq!(
            link_support::reject(&mut link, &RING),
            violation!(BadRing, "SM2-RNG-002")
        );
    }
}
