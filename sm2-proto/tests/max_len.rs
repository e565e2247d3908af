//! The maximum length of a message that each end names in OPEN, on both lanes.

use crate::link_support::*;
use crate::ring_support::{RECEIVER, Rig, SENDER, ring_config, segment};
use sm2_proto::{
    Machine, ViolationKind,
    limits::MESSAGE_MAX,
    link::{
        Body, Config, Counters, End, Error, Fate, Input, Link, MaxLen, Misuse, NoDelivery,
        NoMemory, OutboundMessage, Output, Role, SlotHead, Status,
        wire::{Carrier, Form, Frame, MessageFrame, Open},
    },
    violation,
};

/// The least maximum, in bytes.
const LEAST: u64 = 1_024;

const TOO_LONG: End = End::Violation(violation!(MessageTooLong, "SM2-PAY-010"));

fn short(role: Role) -> Config {
    Config {
        max_len: MaxLen::LEAST,
        ..config(role)
    }
}

/// The OPEN that this end expects, of a peer that accepts messages of up to 1,024 bytes.
fn open_of_short_peer(config: &Config) -> Frame<'static> {
    let Frame::Open(open) = open_to(config) else {
        unreachable!()
    };
    Frame::Open(Open { max_len: 1, ..open })
}

fn sealed_message(id: u64, len: u64) -> OutboundMessage {
    OutboundMessage {
        len,
        body: Body::Sealed,
        ..message(id)
    }
}

//= SM2-OPN-005 test
#[test]
fn a_maximum_is_rounded_up_within_the_range_of_open() {
    for (bytes, expected) in [
        (0, 1_024),
        (1, 1_024),
        (1_024, 1_024),
        (1_025, 2_048),
        (MESSAGE_MAX, MESSAGE_MAX),
        (MESSAGE_MAX + 1, MESSAGE_MAX),
        (u64::MAX, MESSAGE_MAX),
    ] {
        assert_eq!(MaxLen::from_bytes(bytes).bytes(), expected, "{bytes}");
    }
    assert_eq!(MaxLen::default().bytes(), 1 << 30);
}

//= SM2-OPN-005 test
#[test]
fn open_names_the_own_maximum_and_tells_that_of_the_other_end() {
    for role in Role::ALL {
        let mut link = Link::new(short(role));
        let open = sent(&drain(&mut link))[0].to_vec();
        let named = u32::from_le_bytes(open[28..32].try_into().unwrap());
        assert_eq!(named, u32::from(role != Role::Sender), "{role:?}");
        assert_eq!(link.peer_max_len(), MESSAGE_MAX);
        if role == Role::Receiver {
            continue;
        }
        accept(&mut link, &open_of_short_peer(&config(role)));
        assert_eq!(link.peer_max_len(), LEAST, "{role:?}");
    }
}

/// A message from a peer, in this form, and one byte for each byte of an inline payload.
fn from_peer_of_len(carrier: Carrier, form: Form, len: u64, rest: &[u8]) -> MessageFrame<'_> {
    MessageFrame {
        carrier,
        form,
        status: Status::Ok,
        len,
        rest,
        ..from_peer(carrier, 1, 1)
    }
}

//= SM2-PAY-010 test
#[test]
fn on_the_socket_lane_exactly_the_maximum_is_accepted() {
    let bytes = [7; LEAST as usize + 1];
    let pooled = Form::Pooled {
        segment: SEGMENT.id,
        slot: 1,
    };
    for (role, carrier) in [
        (Role::Receiver, Carrier::Data),
        (Role::Server, Carrier::Request),
        (Role::Caller, Carrier::Reply),
    ] {
        for form in [Form::Inline, pooled, Form::Sealed] {
            for len in [LEAST, LEAST + 1] {
                let mut link = opened(short(role));
                accept(&mut link, &Frame::Attach(SEGMENT));
                if role == Role::Caller {
                    send(&mut link, message(1));
                }
                let rest = match form {
                    Form::Inline => &bytes[..len as usize],
                    _ => &[],
                };
                let frame = Frame::Message(from_peer_of_len(carrier, form, len, rest));
                if len == LEAST {
                    accept(&mut link, &frame);
                    let taken = link.take(&NoMemory).unwrap().unwrap();
                    assert_eq!(taken.len, LEAST, "{role:?} {form:?}");
                } else {
                    let found = End::Violation(reject(&mut link, &frame));
                    assert_eq!(found, TOO_LONG, "{role:?} {form:?}");
                }
            }
        }
    }
}

/// The driver keeps and maps a file only after `Output::Keep`, so it never sees this one.
//= SM2-PAY-010 test
#[test]
fn a_file_of_a_message_that_is_too_long_is_not_kept() {
    let mut link = opened(Config {
        max_len: MaxLen::DEFAULT,
        ..config(Role::Receiver)
    });
    let frame = Frame::Message(from_peer_of_len(Carrier::Data, Form::Sealed, 6 << 30, &[]));
    let result = feed(&mut link, &frame.to_vec(), &[sealed(6 << 30)]);
    assert_eq!(result, Err(Error::Ended(TOO_LONG)));
    let outputs = drain(&mut link);
    assert!(!outputs.iter().any(|it| matches!(it, Output::Keep { .. })));
    let close = Frame::Close(ViolationKind::MessageTooLong.code()).to_vec();
    assert_eq!(sent(&outputs)[0].to_vec(), close);
}

/// A sender and a receiver on the ring lane. The receiver accepts 1,024 bytes.
fn short_ring(reliable: bool) -> Rig {
    let [sender, receiver] =
        [Role::Sender, Role::Receiver].map(|role| ring_config(role, reliable, 2, 1));
    let max_len = MaxLen::LEAST;
    Rig::with([
        sender,
        Config {
            max_len,
            ..receiver
        },
    ])
    .opened()
}

fn ring_send(rig: &mut Rig, id: u64, len: u64) -> Result<(), Error> {
    let (slot, status) = (id as u32, Status::Ok);
    let time = NOW;
    let head = SlotHead {
        id,
        time,
        len,
        status,
    };
    rig.heads.insert((0, slot), head.to_bytes());
    let segment = segment(0);
    let body = Body::Pooled { segment, slot };
    let message = OutboundMessage {
        len,
        body,
        ..message(id)
    };
    let sent = rig.ends[SENDER].send(&rig.words, message, |_, _| {});
    rig.drain(SENDER);
    sent.map(drop)
}

//= SM2-PAY-010, SM2-RNG-004 test
#[test]
fn on_the_ring_lane_exactly_the_maximum_is_accepted() {
    for (len, in_head, expected) in [
        (LEAST, LEAST, Ok(LEAST)),
        (LEAST, LEAST + 1, Err(TOO_LONG)),
        // The longest one of its slot.
        (LEAST, 4_096 - 64, Err(TOO_LONG)),
        // The limits of the slot and of the protocol come first.
        (
            LEAST,
            4_096 - 63,
            Err(End::Violation(violation!(BadLength, "SM2-RNG-004"))),
        ),
        (
            LEAST,
            MESSAGE_MAX + 1,
            Err(End::Violation(violation!(BadLength, "SM2-RNG-004"))),
        ),
    ] {
        let mut rig = short_ring(false);
        ring_send(&mut rig, 1, len).unwrap();
        // A hostile sender writes another length into the head.
        let bytes = rig.heads.get_mut(&(0, 1)).unwrap();
        bytes[16..24].copy_from_slice(&in_head.to_le_bytes());
        let taken = rig.take().map(|it| it.map_or(0, |it| it.len));
        assert_eq!(taken, expected.map_err(NoDelivery::Ended), "{in_head}");
        assert_eq!(rig.ends[RECEIVER].end(), expected.err());
    }
}

//= SM2-QOS-008 test
#[test]
fn a_sender_sends_nothing_that_is_too_long() {
    let config = config(Role::Sender);
    let mut link = opened_with(config, &open_of_short_peer(&config));
    send(&mut link, sealed_message(1, LEAST));
    let misuse = Err(Error::Misuse(Misuse::NotAccepted));
    assert_eq!(offer(&mut link, sealed_message(2, LEAST + 1)), misuse);
    assert_eq!(drain(&mut link), []);
    link.handle(NOW, Input::Drop(Fate::TooLong)).unwrap();
    assert!(!link.owes());
    let expected = Counters {
        offered: 2,
        in_flight: 1,
        too_long: 1,
        ..Counters::default()
    };
    assert_eq!(link.counters(), expected);
    assert_eq!(link.counters().dropped(), 1);

    let mut rig = short_ring(true);
    ring_send(&mut rig, 1, LEAST).unwrap();
    assert_eq!(ring_send(&mut rig, 2, LEAST + 1), misuse);
    rig.input(SENDER, Input::Drop(Fate::TooLong)).unwrap();
    assert!(!rig.ends[SENDER].owes());
    assert_eq!(rig.ends[SENDER].counters(), expected);
}

//= SM2-QOS-008 test
#[test]
fn only_a_sender_counts_messages_as_too_long() {
    for role in [Role::Receiver, Role::Caller, Role::Server] {
        let mut link = opened(config(role));
        let result = link.handle(NOW, Input::Drop(Fate::TooLong));
        assert_eq!(result, Err(Error::Misuse(Misuse::WrongRole)), "{role:?}");
    }
}

//= SM2-QOS-008, SM2-SRV-006 test
#[test]
fn messages_that_were_queued_before_open_are_dropped() {
    for role in [Role::Sender, Role::Caller] {
        let config = config(role);
        let mut link = Link::new(config);
        drain(&mut link);
        send(&mut link, sealed_message(1, LEAST + 1));
        send(&mut link, sealed_message(2, LEAST));
        let outputs = accept(&mut link, &open_of_short_peer(&config));
        assert_eq!(settled(&outputs), [(1, Fate::TooLong)]);
        assert_eq!(sent(&outputs).len(), 1);
        let failed = outputs.contains(&Output::CallFailed { call: 1 });
        assert_eq!(failed, role == Role::Caller);
        assert_eq!(link.calls(), usize::from(role == Role::Caller));
        let it = link.counters();
        assert_eq!((it.offered, it.too_long, it.in_flight), (2, 1, 1));
    }
}

//= SM2-SRV-006, SM2-SRV-007 test
#[test]
fn callers_and_servers_send_nothing_that_is_too_long() {
    let misuse = Err(Error::Misuse(Misuse::NotAccepted));
    let it = config(Role::Caller);
    let mut caller = opened_with(it, &open_of_short_peer(&it));
    assert_eq!(offer(&mut caller, sealed_message(1, LEAST + 1)), misuse);
    assert_eq!(caller.calls(), 0);
    send(&mut caller, sealed_message(1, LEAST));
    assert_eq!(caller.calls(), 1);

    let it = config(Role::Server);
    let mut server = opened_with(it, &open_of_short_peer(&it));
    accept(&mut server, &request(1, 1));
    server.take(&NoMemory).unwrap().unwrap();
    assert_eq!(offer(&mut server, sealed_message(1, LEAST + 1)), misuse);
    // The call is still open: the server can say that its reply is too long.
    assert_eq!(server.calls(), 1);
    send(&mut server, message(1));
    assert_eq!(server.calls(), 0);
}
