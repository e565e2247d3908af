//! The setup of a ring, and the layout of its file: SPEC section 8.5.

// Shows RNG-INDEX, LNK-PHASE (test).

use crate::link_support;

use crate::link_support::{NOW, RING, accept, drain, message, opened, reliable, sent, with_ring};
use crate::ring_support::{RECEIVER, Rig, SENDER, ring_config, segment, word};
use sm2_proto::{
    Instant, Machine,
    limits::{RING_SEGMENTS_MAX, SLOT_HEAD},
    link::{
        At, Attachment, Body, Config, Error, Fate, FrameKind, Input, LaneKind, LentRing, Link,
        Misuse, NoDelivery, NoMemory, NotAWord, OutboundMessage, Output, RingLayout, Role,
        SegmentInfo, SlotHead, Status, Wake, Word, doorbell,
        wire::{Carrier, Frame},
    },
    violation,
};

//= SM2-RNG-002, SM2-RNG-012 test
#[test]
fn open_then_ring_then_all_else() {
    let mut rig = Rig::fresh(false, 2, 1);
    assert_eq!(rig.underway(SENDER), [FrameKind::Open]);
    assert_eq!(
        rig.underway(RECEIVER),
        [FrameKind::Open, FrameKind::Ring],
        "RING does not wait for the other end"
    );
    assert_eq!(rig.wires[RECEIVER][1].0, RING.to_vec());
    assert!(rig.carry(RECEIVER));
    assert_eq!(rig.outputs[SENDER], [Output::Opened]);
    assert!(rig.ends[SENDER].lane() == LaneKind::Ring && !rig.ends[SENDER].is_open());
    assert_eq!(
        rig.send(1, 0),
        Err(Error::Misuse(Misuse::NotOpen)),
        "no message before RING"
    );
    assert!(!rig.room());

    assert!(rig.carry(RECEIVER));
    let layout = RingLayout::new(2, 3).unwrap();
    assert_eq!(rig.outputs[SENDER][1..], [Output::Ring(layout)]);
    assert!(rig.ends[SENDER].is_open() && rig.room());

    assert!(rig.carry(SENDER));
    assert_eq!(rig.outputs[RECEIVER], [Output::Opened]);
    assert_eq!(rig.underway(RECEIVER), []);
    assert!(rig.ends[RECEIVER].is_open());
    assert_eq!(doorbell()[..], Frame::Doorbell.to_vec());
}

/// RING is the first frame after OPEN, even if a full socket has delayed OPEN.
//= SM2-RNG-002 test
#[test]
fn ring_waits_for_our_open_and_goes_before_detached() {
    let mut link = Link::new(with_ring(Role::Receiver));
    // The driver keeps OPEN, which the socket does not accept.
    assert!(matches!(link.poll(), Some(Output::Transmit(_))));
    link.handle(NOW, Input::Blocked).unwrap();
    let open = link_support::open_to(&with_ring(Role::Receiver));
    accept(&mut link, &open);
    accept(&mut link, &Frame::Attach(link_support::SEGMENT));
    accept(&mut link, &Frame::Detach { segment: 5 });
    link.handle(NOW, Input::Writable).unwrap();
    let packets = sent(&drain(&mut link));
    assert_eq!(packets[0].to_vec(), RING.to_vec());
    assert_eq!(packets[0].attachment, Some(Attachment::Ring));
    assert_eq!(packets[1].to_vec(), Frame::Detached { segment: 5 }.to_vec());
    assert_eq!(packets.len(), 2);
}

//= SM2-RNG-002 test
#[test]
fn the_layout_is_that_of_the_table() {
    // Columns: depth, window, offset of the back words, size.
    let rows = [
        (1, 2, 256, 4096),
        (2, 3, 384, 4096),
        (8, 9, 1152, 4096),
        (28, 48, 3712, 4096),
        (28, 49, 3712, 8192),
        (29, 32, 3840, 4096),
        (29, 33, 3840, 8192),
        (1024, 2048, 131_200, 151_552),
    ];
    for (depth, window, back, size) in rows {
        let layout = RingLayout::new(depth, window).unwrap();
        assert_eq!((layout.depth(), layout.window()), (depth, window));
        assert_eq!(layout.offset(At::ReceiverParked), Some(0));
        assert_eq!(layout.offset(At::SenderParked), Some(64));
        assert_eq!(layout.offset(At::Forward(0)), Some(128));
        let last = u32::from(depth) - 1;
        let end = 128 + 128 * u64::from(last);
        assert_eq!(layout.offset(At::Forward(last)), Some(end));
        assert_eq!(layout.offset(At::Forward(last + 1)), None);
        assert_eq!(layout.offset(At::Back(0)), Some(back), "{depth}");
        let last = back + 8 * u64::from(window - 1);
        assert_eq!(layout.offset(At::Back(window - 1)), Some(last));
        assert_eq!(layout.offset(At::Back(window)), None);
        assert_eq!(layout.size_bytes(), size, "{depth} {window}");
    }
    let illegal = [(0, 1), (1, 1), (1, 0), (2, 2), (1025, 2048), (1024, 2049)];
    for (depth, window) in illegal {
        assert_eq!(RingLayout::new(depth, window), None, "{depth} {window}");
    }
}

//= SM2-RNG-003 test
#[test]
fn the_bits_of_a_word() {
    let word = Word::new(0x1234, 0xabcd, 0x9_0000_0007).unwrap();
    assert_eq!(word.to_bits(), 0x0000_0007_9234_abcd);
    assert_eq!(Word::from_bits(word.to_bits()), Ok(Some(word)));
    let most = Word::new(32_767, 65_535, u64::MAX).unwrap();
    assert_eq!(most.to_bits(), u64::MAX);
    assert_eq!(Word::new(0, 0, 1 << 32).unwrap().to_bits(), 1 << 31);
    assert_eq!(Word::new(RING_SEGMENTS_MAX, 0, 1), None);
    assert_eq!(Word::new(0, 65_536, 1), None);
    assert_eq!(Word::from_bits(0), Ok(None));
    for bits in [1, 1 << 30, 1 << 32, u64::MAX ^ (1 << 31)] {
        assert_eq!(Word::from_bits(bits), Err(NotAWord), "{bits:x}");
    }
}

//= SM2-RNG-004 test
#[test]
fn the_bytes_of_a_head() {
    let head = SlotHead {
        id: 0x0102_0304_0506_0708,
        time: sm2_proto::Instant(9),
        len: u64::MAX,
        status: Status::Failed,
    };
    let bytes = head.to_bytes();
    assert_eq!(bytes[..9], [8, 7, 6, 5, 4, 3, 2, 1, 9]);
    assert_eq!(bytes[16..24], [0xff; 8]);
    assert_eq!(bytes[24], 1);
    assert_eq!(bytes[25..], [0; 39]);
    assert_eq!(SlotHead::from_bytes(&bytes, Carrier::Reply), Ok(head));
    let reserved = Err(violation!(ReservedNotZero, "SM2-RNG-004"));
    for carrier in [Carrier::Data, Carrier::Request] {
        assert_eq!(SlotHead::from_bytes(&bytes, carrier), reserved, "a status");
    }
    for at in 0..SLOT_HEAD {
        let mut changed = bytes;
        changed[at] ^= 0x80;
        let verdict = SlotHead::from_bytes(&changed, Carrier::Reply).map(drop);
        let expected = match at {
            0..24 => Ok(()),
            24 | 25 => Err(violation!(Malformed, "SM2-RNG-004")),
            _ => reserved.map(drop),
        };
        assert_eq!(verdict, expected, "byte {at}");
    }
}

/// A segment with an impossible geometry, or with a number that no word can hold, is refused before
/// ATTACH is sent.
//= SM2-RNG-003, SM2-SEG-003 test
#[test]
fn only_segments_that_a_word_can_name() {
    let mut rig = Rig::open(false, 2, 1);
    let refused = |rig: &mut Rig, info| {
        let result = rig.input(SENDER, Input::Attach(info));
        assert_eq!(result, Err(Error::Misuse(Misuse::BadSegment)), "{info:?}");
    };
    refused(&mut rig, segment(RING_SEGMENTS_MAX));
    let one = segment(1);
    refused(&mut rig, SegmentInfo { slots: 0, ..one });
    refused(
        &mut rig,
        SegmentInfo {
            stride: 4095,
            ..one
        },
    );
    let other = SegmentInfo {
        slots: 3,
        ..segment(0)
    };
    let changed = rig.input(SENDER, Input::Attach(other));
    assert_eq!(changed, Err(Error::Misuse(Misuse::SegmentChanged)));
    rig.attach(segment(RING_SEGMENTS_MAX - 1));
    rig.pump();
    assert_eq!(
        rig.send_in(segment(RING_SEGMENTS_MAX - 1), 1, 15),
        Ok(Wake::NotNeeded)
    );
    assert_eq!(rig.words.forward()[1], word(32_767, 15, 1));
}

/// A word may name a segment only after its ATTACH was written to the socket.
//= SM2-RNG-003 test
#[test]
fn a_message_waits_for_its_segment() {
    let mut rig = Rig::open(false, 2, 1);
    let not_attached = Err(Error::Misuse(Misuse::NotAttached));
    assert_eq!(rig.send_in(segment(1), 1, 0), not_attached);
    // The ATTACH is queued, but not drained.
    rig.ends[SENDER]
        .handle(NOW, Input::Attach(segment(1)))
        .unwrap();
    let message = OutboundMessage {
        key: 1,
        id: 1,
        time: Instant(0),
        status: Status::Ok,
        len: 0,
        body: Body::Pooled {
            segment: segment(1),
            slot: 0,
        },
    };
    let early = rig.ends[SENDER].send(&rig.words, message.clone(), |_, _| {});
    assert_eq!(early, not_attached);
    assert_eq!(rig.words.take_accesses(), 0, "misuse touches nothing");
    // The socket refused ATTACH, so there is no room.
    rig.ends[SENDER].handle(NOW, Input::Blocked).unwrap();
    assert_eq!(rig.send(1, 0), Err(Error::Misuse(Misuse::NoRoom)));
    assert!(!rig.room());
}

/// A side that does not offer the ring lane checks the RING of a side that does, and does not use it.
//= SM2-RNG-001, SM2-RNG-002 test
#[test]
fn a_ring_that_is_not_used() {
    for role in [Role::Sender, Role::Caller, Role::Server] {
        let mut link = Link::new(link_support::config(role));
        drain(&mut link);
        accept(&mut link, &link_support::open_to(&with_ring(role)));
        assert!(link.lane() == LaneKind::Socket && link.is_open());
        assert_eq!(accept(&mut link, &RING), []);
        let second = link_support::reject(&mut link, &RING);
        assert_eq!(second, violation!(BadRing, "SM2-RNG-002"));
    }
    // Its own ring is not used either: it has sent RING before it knew the lane.
    let mut link = Link::new(with_ring(Role::Receiver));
    assert_eq!(sent(&drain(&mut link)).len(), 2);
    accept(
        &mut link,
        &link_support::open_to(&link_support::config(Role::Receiver)),
    );
    assert!(link.lane() == LaneKind::Socket && link.is_open());
}

/// Before OPEN arrives the lane is unknown, so no message is accepted: it might be for the wrong
/// lane.
//= SM2-RNG-001, SM2-RNG-002 test
#[test]
fn nothing_is_taken_before_the_lane_is_known() {
    let mut link = Link::new(with_ring(Role::Sender));
    drain(&mut link);
    assert!(!link.has_room(&NoMemory));
    let refused = link_support::offer(&mut link, message(1));
    assert_eq!(refused, Err(Error::Misuse(Misuse::NotOpen)));
    accept(&mut link, &link_support::open_to(&with_ring(Role::Sender)));
    accept(&mut link, &RING);
    assert_eq!(link.in_flight(), 0);
    // On the socket lane, messages are accepted right after OPEN.
    let mut link = Link::new(with_ring(Role::Sender));
    drain(&mut link);
    accept(
        &mut link,
        &link_support::open_to(&link_support::config(Role::Sender)),
    );
    assert!(link.has_room(&NoMemory) && link.is_open());
    assert_eq!(sent(&link_support::send(&mut link, message(1))).len(), 1);
}

/// Both lanes have the same calls. A call that the role does not have, or that needs a ring and
/// gets none, is misuse.
#[test]
fn the_calls_are_the_same_on_both_lanes() {
    let mut rig = Rig::open(true, 2, 1);
    let not_lent = Error::Misuse(Misuse::NotLent);
    let sent = link_support::offer(&mut rig.ends[SENDER], message(1));
    assert_eq!(sent, Err(not_lent));
    assert!(!rig.ends[SENDER].has_room(&NoMemory));
    let released = link_support::give_back(&mut rig.ends[RECEIVER], 1);
    assert_eq!(released, Err(not_lent));
    let taken = rig.ends[RECEIVER].take(&NoMemory);
    assert_eq!(taken, Err(NoDelivery::Misuse(Misuse::NotLent)));
    let ring = [rig.ends[SENDER].clone(), rig.ends[RECEIVER].clone()];
    let socket = [Role::Sender, Role::Receiver].map(|role| opened(reliable(role)));
    for [mut sender, mut receiver] in [ring, socket] {
        let wrong = Err(Error::Misuse(Misuse::WrongRole));
        let taken = sender.take(&LentRing::new(&rig.words, |_| None));
        assert_eq!(taken, Err(NoDelivery::Misuse(Misuse::WrongRole)));
        assert_eq!(sender.release(&rig.words, 1), wrong);
        let sent = receiver.send(&rig.words, message(1), |_, _| {});
        assert_eq!(sent, wrong);
        let wrong = wrong.map(drop);
        assert_eq!(receiver.handle(NOW, Input::Drop(Fate::Overwritten)), wrong);
        assert_eq!(receiver.handle(NOW, Input::Attach(segment(0))), wrong);
        assert_eq!(sender.handle(NOW, Input::Attach(segment(0))), Ok(()));
        let harvested = receiver.harvest(&rig.words, |_, _| {});
        assert_eq!(harvested, Ok(Wake::NotNeeded));
        assert!(!receiver.has_room(&rig.words) && !sender.may_take(&rig.words));
        assert_eq!(sender.handle(NOW, Input::Drop(Fate::Overwritten)), Ok(()));
        let counters = sender.counters();
        assert_eq!((counters.offered, counters.overwritten), (1, 1));
    }
    assert_eq!(rig.words.take_accesses(), 0);
    let socket = opened(reliable(Role::Sender));
    socket.park(&rig.words);
    socket.unpark(&rig.words);
    assert_eq!(rig.words.take_accesses(), 0);
}

/// The window is `depth + max_borrowed` of the receiver. The sender's depth does not matter.
//= SM2-RNG-002 test
#[test]
fn the_ring_is_as_deep_as_the_receiver_says() {
    let config = Config {
        depth: 7,
        ..ring_config(Role::Sender, false, 1, 1)
    };
    let mut link = link_support::opened_with(config, &link_support::open_to(&config));
    let outputs = accept(&mut link, &RING);
    let layout = RingLayout::new(2, 3).unwrap();
    assert_eq!(outputs, [Output::Ring(layout)]);
}
