//! Calls on the ring lane, step by step: SPEC sections 8.5 and 9.

// Shows CALL-RING, CALL-CANCEL, RNG-WAKE (test).

use crate::link_support::{NOW, opened, with_ring};
use crate::ring_support::calls::{CALLER, Calls, Outcome, SERVER, segment};
use bytes::Bytes;
use sm2_proto::{
    Datagram, FdFacts, Instant, Machine,
    limits::CALLS_MAX,
    link::{
        At, Body, Config, Counters, Error, Fate, FrameKind, Input, LaneKind, Misuse,
        OutboundMessage, Output, RingLayout, Role, Status, Wake, wire::Frame,
    },
};

/// The server takes requests with depth 2 and two borrowed. The caller has room for the replies of
/// three calls.
pub(crate) fn pair() -> Calls {
    Calls::open([1, 2], [3, 2])
}

fn kinds(pair: &Calls, end: usize) -> Vec<FrameKind> {
    let wires = pair.world.wires.borrow();
    let kind = |it: &(Vec<u8>, Vec<FdFacts>)| FrameKind::from_number(it.0[0]).unwrap();
    wires[end].iter().map(kind).collect()
}

//= SM2-RNG-001, SM2-RNG-002 test
#[test]
fn each_end_makes_the_ring_that_it_takes_from() {
    let mut pair = Calls::fresh([1, 2], [3, 2]);
    pair.read(SERVER);
    let requests = RingLayout::new(2, 4).unwrap();
    // The caller's ring has a place for the reply to each call.
    let replies = RingLayout::new(3, 4).unwrap();
    assert_eq!(pair.server.outputs, [Output::Opened]);
    assert_eq!(kinds(&pair, SERVER), [FrameKind::Open, FrameKind::Ring]);
    assert!(pair.server.link.lane() == LaneKind::Ring && !pair.server.link.is_open());
    pair.pump();
    assert_eq!(pair.server.outputs, [Output::Opened, Output::Ring(replies)]);
    assert_eq!(
        pair.caller.outputs,
        [Output::Opened, Output::Ring(requests)]
    );
    assert!(pair.server.link.is_open() && pair.caller.link.is_open());
}

/// The caller's ring has as many places as the limit of depths allows, even where the window is
/// larger.
//= SM2-RNG-002 test
#[test]
fn a_caller_has_a_place_for_each_reply_within_the_limits() {
    for (depth, max_borrowed, expected) in [
        (1, 1, 1),
        (1, 64, 64),
        (1, 1023, 1023),
        (1, 1024, 1024),
        (1024, 1024, 1024),
    ] {
        let config = Config {
            depth,
            max_borrowed,
            ..with_ring(Role::Caller)
        };
        let layout = config.ring_layout().unwrap();
        assert_eq!(layout.depth(), expected);
        assert_eq!(layout.window(), u32::from(depth + max_borrowed));
    }
    assert_eq!(with_ring(Role::Sender).ring_layout(), None);
}

//= SM2-SRV-001, SM2-SRV-002, SM2-RNG-004 test
#[test]
fn a_call_and_its_reply() {
    let mut pair = pair();
    pair.call();
    assert_eq!(kinds(&pair, CALLER), [FrameKind::Attach]);
    assert_eq!(pair.caller.link.calls(), 1);
    pair.take(SERVER);
    assert_eq!(pair.server.taken, [1]);
    assert_eq!((pair.server.link.calls(), pair.server.held.len()), (1, 1));
    pair.reply();
    assert_eq!(pair.server.link.calls(), 0);
    pair.release(SERVER);
    pair.take(CALLER);
    assert_eq!(pair.caller.calls[&1], Some(Outcome::Reply(Status::Ok)));
    assert_eq!((pair.caller.link.calls(), pair.caller.held.len()), (0, 1));
    pair.release(CALLER);
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
    // While both ends are awake, the sockets carry only segments.
    assert_eq!(
        (kinds(&pair, CALLER), kinds(&pair, SERVER)),
        (vec![], vec![])
    );
}

/// A call or reply without room waits at its sender, is counted, and is sent once there is room.
//= SM2-RNG-012, SM2-QOS-006 test
#[test]
fn calls_and_replies_that_wait_for_room() {
    let mut pair = pair();
    for _ in 0..5 {
        pair.call();
    }
    pair.pump();
    pair.harvest(CALLER);
    assert!(pair.caller.link.has_queued());
    assert_eq!(pair.world.rings[SERVER].read(At::SenderParked), 1);
    let counters = pair.caller.link.counters();
    assert_eq!((counters.offered, counters.in_flight), (5, 5));
    assert_eq!(
        (pair.caller.link.in_flight(), pair.caller.link.calls()),
        (5, 5)
    );
    // Taking a request makes room, and wakes the waiting caller.
    pair.take(SERVER);
    assert_eq!(kinds(&pair, SERVER), [FrameKind::Doorbell]);
    assert_eq!(pair.world.rings[SERVER].read(At::SenderParked), 0);
    pair.harvest(CALLER);
    assert!(pair.caller.link.has_queued());
    for _ in 0..5 {
        pair.harvest(CALLER);
        pair.take(SERVER);
        pair.reply();
        pair.release(SERVER);
    }
    assert_eq!(pair.server.taken, [1, 3, 5, 7, 9]);
    // The ring has three places for replies.
    assert!(!pair.caller.link.has_queued() && pair.server.link.has_queued());
    for _ in 0..6 {
        pair.take(CALLER);
        pair.release(CALLER);
        pair.harvest(SERVER);
    }
    assert!(!pair.server.link.has_queued());
    assert!(
        pair.caller
            .calls
            .values()
            .all(|it| matches!(it, Some(Outcome::Reply(_))))
    );
}

pub(crate) fn request(id: u64, slot: u32) -> OutboundMessage {
    OutboundMessage {
        key: id,
        id,
        time: Instant(0),
        status: Status::Ok,
        len: 0,
        body: Body::Pooled {
            segment: segment(0),
            slot,
        },
    }
}

/// The limit includes the calls that wait for room.
//= SM2-SRV-001 test
#[test]
fn no_more_calls_than_the_limit() {
    let mut pair = pair();
    let words = &pair.world.rings[SERVER];
    let link = &mut pair.caller.link;
    let mut send = |id, slot| link.send(words, request(id, slot), |_, _| {});
    for id in 1..=CALLS_MAX as u64 {
        assert_eq!(send(id, 0), Ok(Wake::NotNeeded));
    }
    let misuse = |it| Err(Error::Misuse(it));
    assert_eq!(send(2000, 0), misuse(Misuse::CallLimit));
    assert!(!link.has_room(words));
    assert_eq!(link.in_flight(), CALLS_MAX);
}

#[test]
fn what_can_never_be_sent_is_refused_at_once() {
    let mut pair = pair();
    let words = &pair.world.rings[SERVER];
    let mut expect = |message: OutboundMessage, misuse| {
        let before = pair.caller.link.clone();
        let sent = pair.caller.link.send(words, message.clone(), |_, _| {});
        assert_eq!(sent, Err(Error::Misuse(misuse)));
        assert!(pair.caller.link == before);
    };
    let good = request(5, 0);
    let within = |segment| OutboundMessage {
        body: Body::Pooled { segment, slot: 0 },
        ..request(5, 0)
    };
    let mut other = segment(0);
    other.id = 32_768;
    expect(within(other), Misuse::BadSegment);
    other.id = 0;
    other.stride = 4095;
    expect(within(other), Misuse::BadSegment);
    let inline = OutboundMessage {
        body: Body::Inline(Bytes::new()),
        ..request(5, 0)
    };
    expect(inline, Misuse::NotPooled);
    expect(request(5, 8), Misuse::SlotOutside);
    let of_length = |len| OutboundMessage {
        len,
        ..request(5, 0)
    };
    expect(of_length(4033), Misuse::TooLong);
    let longest = of_length(4032);
    let sent = pair.caller.link.send(words, longest.clone(), |_, _| {});
    assert_eq!(sent, Ok(Wake::NotNeeded));
    let late = pair.caller.link.send(words, request(5, 1), |_, _| {});
    assert_eq!(late, Err(Error::Misuse(Misuse::IdNotGrowing)));
    let reply = (pair.server.link).send(&pair.world.rings[CALLER], good.clone(), |_, _| {});
    assert_eq!(reply, Err(Error::Misuse(Misuse::UnknownCall)));
    assert_eq!(
        pair.caller.link.handle(NOW, Input::Drop(Fate::Overwritten)),
        Err(Misuse::WrongRole.into())
    );
    // Before RING arrives, the caller does not know how many calls have room.
    let mut early = opened(with_ring(Role::Caller));
    let sent = early.send(words, good.clone(), |_, _| {});
    assert_eq!(sent, Err(Error::Misuse(Misuse::NotOpen)));
}

pub(crate) fn cancel(pair: &mut Calls, call: u64) -> Result<(), Error> {
    let bytes = Frame::Cancel { call }.to_vec();
    let result = (pair.server.link).handle(NOW, Input::Datagram(Datagram::new(&bytes)));
    pair.server.drain(&pair.world);
    result
}

//= SM2-RNG-011, SM2-SRV-003 test
#[test]
fn a_cancel_that_overtakes_its_request() {
    let mut pair = pair();
    pair.call();
    pair.call();
    pair.pump();
    pair.harvest(CALLER);
    pair.caller.cancel(&pair.world, 0);
    pair.read(SERVER);
    assert!(pair.server.cancelled.is_empty());
    pair.take(SERVER);
    assert!(pair.server.cancelled.is_empty(), "that is another call");
    pair.take(SERVER);
    assert!(pair.server.cancelled.contains(&3));
    pair.reply();
    pair.reply();
    pair.take(CALLER);
    pair.take(CALLER);
    assert_eq!(
        pair.caller.calls[&3],
        Some(Outcome::Reply(Status::Cancelled))
    );
}

/// The reply is sent, taken and released before the server reads the CANCEL.
//= SM2-RNG-011 test
#[test]
fn a_cancel_that_is_overtaken_by_its_reply() {
    for taken in [false, true] {
        let mut pair = pair();
        pair.call();
        pair.take(SERVER);
        pair.caller.cancel(&pair.world, 0);
        pair.reply();
        if taken {
            pair.take(CALLER);
            pair.release(CALLER);
            pair.harvest(SERVER);
        }
        pair.pump();
        assert_eq!(pair.end_of(SERVER), None);
        assert_eq!(cancel(&mut pair, 1), Ok(()), "so is any other");
        assert!(pair.server.cancelled.is_empty());
    }
}

/// A caller sends one CANCEL per call, and none once it has taken the reply.
//= SM2-RNG-011 test
#[test]
fn a_caller_cancels_while_it_waits() {
    let mut pair = pair();
    pair.call();
    pair.pump();
    pair.harvest(CALLER);
    pair.caller.cancel(&pair.world, 0);
    pair.caller.cancel(&pair.world, 0);
    assert_eq!(kinds(&pair, CALLER), [FrameKind::Cancel]);
    pair.take(SERVER);
    pair.reply();
    pair.take(CALLER);
    pair.pump();
    pair.caller.cancel(&pair.world, 0);
    assert_eq!(kinds(&pair, CALLER), []);
    let unknown = pair.caller.link.handle(NOW, Input::Cancel { call: 7 });
    assert_eq!(unknown, Err(Error::Misuse(Misuse::UnknownCall)));
}

/// The server has replied to one of two calls when the stream ends.
//= SM2-RNG-010, SM2-SRV-004 test
#[test]
fn a_reply_in_the_ring_has_come() {
    let mut pair = pair();
    for _ in 0..2 {
        pair.call();
        pair.take(SERVER);
    }
    pair.reply();
    pair.server.close(&pair.world, Input::Eof);
    while pair.caller.link.end().is_none() {
        pair.read(CALLER);
    }
    assert_eq!(pair.caller.calls[&1], None);
    assert_eq!(
        pair.caller.link.calls(),
        2,
        "the rings were not looked at yet"
    );
    pair.take(CALLER);
    assert_eq!(pair.caller.calls[&1], Some(Outcome::Reply(Status::Ok)));
    assert_eq!(pair.caller.calls[&3], None);
    pair.take(CALLER);
    assert_eq!(pair.caller.calls[&3], Some(Outcome::Failed));
    assert_eq!(pair.caller.link.calls(), 0);
}

/// After the caller has gone, requests left in the ring are ignored.
//= SM2-RNG-010 test
#[test]
fn a_request_in_the_ring_when_the_caller_went() {
    let mut pair = pair();
    pair.call();
    pair.pump();
    pair.harvest(CALLER);
    pair.caller.close(&pair.world, Input::Eof);
    while pair.server.link.end().is_none() {
        pair.read(SERVER);
    }
    pair.take(SERVER);
    assert_eq!(pair.server.taken, [1]);
    assert_eq!((pair.server.link.calls(), pair.server.owed.len()), (0, 0));
    pair.release(SERVER);
    assert!(pair.server.held.is_empty());
}
