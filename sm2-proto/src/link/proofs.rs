//! Harnesses for a link's frames, tables, addresses and windows.

use super::{
    Body, Carrier, Config, End, Error, Fate, FrameKind, Input, Link, MaxLen, NoMemory,
    OutboundMessage, Output, Publications, Role, Status, Wake,
    inbound::Inbound,
    lane,
    phase::{Phase, check_kind},
    segments::{Geometry, Verified},
    wire::{Form, Frame, Given, MessageFrame},
};
use crate::{
    Code, Datagram, FdFacts, Instant, LinkId, Machine, Period, Seals, VERSION,
    limits::{MESSAGE_HEAD, MESSAGE_MAX, SEGMENT_BYTES_MAX, SLOTS_MAX},
    proofs::{below, one_of},
};

const NOW: Instant = Instant(0);

pub(super) fn role() -> Role {
    one_of(&Role::ALL)
}

pub(super) fn config(role: Role) -> Config {
    Config {
        id: LinkId {
            epoch: 7,
            serial: 8,
        },
        version: VERSION,
        role,
        reliable: false,
        sealed: false,
        ring: false,
        depth: 1,
        max_borrowed: 1,
        max_len: MaxLen::GREATEST,
        deadline: Period::NONE,
        lifespan: Period::NONE,
        lease: Period::NONE,
        publications: Publications::UNKNOWN,
    }
}

/// The lanes where a frame is legal.
#[derive(Clone, Copy, PartialEq)]
enum Lane {
    Both,
    Socket,
    Ring,
}

/// The table of SPEC section 7 and SM2-RNG-001. For each kind: its number; whether sender,
/// receiver, caller and server receive it; and its lanes.
const RECEIVED_BY: [(u8, [bool; 4], Lane); 13] = [
    (1, [true, true, true, true], Lane::Both),
    (2, [false, true, true, true], Lane::Both),
    (3, [false, true, true, true], Lane::Both),
    (4, [false, true, false, false], Lane::Socket),
    (5, [false, false, false, true], Lane::Socket),
    (6, [false, false, true, false], Lane::Socket),
    (7, [true, false, true, true], Lane::Socket),
    (8, [false, false, false, true], Lane::Both),
    (9, [true, true, true, true], Lane::Both),
    (16, [true, false, true, true], Lane::Ring),
    (17, [true, true, true, true], Lane::Ring),
    (18, [true, false, true, true], Lane::Ring),
    (19, [false, true, false, false], Lane::Both),
];

//= SM2-OPN-001, SM2-WIR-002, SM2-RNG-001 kani
// Shows LNK-PHASE (Exhaustive), bound: none: one step from any phase.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(15))]
fn link_phase_table() {
    let (role, opening, ring) = (role(), kani::any(), kani::any());
    let phase = if opening { Phase::Opening } else { Phase::Open };
    let number: u8 = kani::any();
    let row = RECEIVED_BY.iter().find(|row| row.0 == number);
    let (Some(kind), Some((_, received, lane))) = (FrameKind::from_number(number), row) else {
        assert!(row.is_none() && FrameKind::from_number(number).is_none());
        return;
    };
    let received = received[role as usize];
    let other_lane = *lane == if ring { Lane::Socket } else { Lane::Ring };
    let verdict = check_kind(phase, role, ring, kind);
    let expected = match kind {
        FrameKind::Close => Ok(()),
        FrameKind::Open if opening => Ok(()),
        FrameKind::Open => Err(violation!(UnexpectedOpen, "SM2-OPN-001")),
        _ if opening => Err(violation!(ExpectedOpen, "SM2-OPN-001")),
        _ if !received => Err(violation!(WrongRole, "SM2-WIR-002")),
        _ if other_lane => Err(violation!(WrongLane, "SM2-RNG-001")),
        _ => Ok(()),
    };
    assert_eq!(verdict, expected);
    kani::cover!(
        verdict == Err(violation!(WrongLane, "SM2-RNG-001")) && ring,
        "not on a ring"
    );
    kani::cover!(
        verdict == Err(violation!(WrongRole, "SM2-WIR-002")),
        "not for this role"
    );
    kani::cover!(verdict.is_ok() && kind == FrameKind::Reply, "a reply");
}

/// Checks that a frame that is decoded encodes to the same bytes.
fn is_canonical(bytes: &[u8]) -> Option<FrameKind> {
    let descriptor = [FdFacts::default()];
    let count = usize::from(kani::any::<bool>());
    let datagram = Datagram {
        fds: &descriptor[..count],
        ..Datagram::new(bytes)
    };
    let frame = Frame::decode(&datagram).ok()?;
    assert_eq!(frame.fds(), count);
    if frame.check_length().is_ok() {
        assert!(frame.to_vec() == bytes);
    }
    Some(frame.kind())
}

/// The reserved bytes of the frames without payload, from SPEC section 7.
const RESERVED: [(u8, usize, &[usize]); 9] = [
    (1, 48, &[]),
    (2, 24, &[1, 2, 3, 20, 21, 22, 23]),
    (3, 8, &[1, 2, 3]),
    (7, 8, &[4, 5, 6, 7]),
    (8, 16, &[1, 2, 3, 4, 5, 6, 7]),
    (9, 8, &[1, 4, 5, 6, 7]),
    (16, 16, &[1, 8, 9, 10, 11, 12, 13, 14, 15]),
    (17, 8, &[1, 2, 3, 4, 5, 6, 7]),
    (18, 8, &[1, 2, 3]),
];

/// DECODE-TOTAL and DECODE-CANONICAL for frames of fixed length.
//= SM2-WIR-001, SM2-TRN-010 kani
// Shows DECODE-FIXED (Samples), bound: up to 33 bytes, 0 or 1 descriptor.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(50))]
fn fixed_frames_are_canonical() {
    let (number, exact, reserved) = one_of(&RESERVED);
    let (other_len, clean): (bool, bool) = kani::any();
    let mut bytes: [u8; 49] = kani::any();
    bytes[0] = number;
    if clean {
        reserved.iter().for_each(|at| bytes[*at] = 0);
        // Often one reserved byte is the only fault.
        if !reserved.is_empty() {
            bytes[one_of(reserved)] = kani::any();
        }
    }
    let len = if other_len { below(50) } else { exact };
    let kind = is_canonical(&bytes[..len]);
    if kind.is_some() {
        assert!(reserved.iter().all(|at| bytes[*at] == 0));
        assert!(len == exact || kind == Some(FrameKind::Release));
    }
    kani::cover!(kind == Some(FrameKind::Open), "OPEN");
    kani::cover!(kind == Some(FrameKind::Attach), "ATTACH");
    kani::cover!(kind == Some(FrameKind::Close), "CLOSE");
    kani::cover!(kind == Some(FrameKind::Ring), "RING");
    kani::cover!(
        kind.is_none() && clean && len == exact,
        "refused in spite of its length"
    );
}

/// Sets one byte of a frame of zeros: checks which bytes are reserved, and which values are
/// illegal.
//= SM2-WIR-001, SM2-TRN-010, SM2-MSG-004 kani
// Shows DECODE-FIXED (Exhaustive), bound: one byte of any value at any place.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(50))]
fn each_reserved_byte_is_checked() {
    let (number, exact, reserved) = one_of(&RESERVED);
    let at = 1 + below(exact - 1);
    let value = kani::any();
    let mut bytes = [0; 48];
    (bytes[0], bytes[at]) = (number, value);
    let descriptors = [FdFacts::default()];
    let fds = below(2);
    let datagram = Datagram {
        fds: &descriptors[..fds],
        ..Datagram::new(&bytes[..exact])
    };
    let takes_file = [FrameKind::Attach as u8, FrameKind::Ring as u8].contains(&number);
    let unknown_fate = number == FrameKind::Release as u8 && at == 1 && value > 2;
    let expected = if reserved.contains(&at) && value != 0 {
        Err(violation!(ReservedNotZero, "SM2-WIR-001"))
    } else if unknown_fate {
        Err(violation!(Malformed, "SM2-MSG-004"))
    } else if (fds == 1) != takes_file {
        Err(violation!(FdCount, "SM2-TRN-010"))
    } else {
        Ok(())
    };
    assert_eq!(Frame::decode(&datagram).map(drop), expected);
    kani::cover!(unknown_fate, "an unknown fate");
    kani::cover!(expected.is_ok() && takes_file, "a frame with its file");
}

/// DECODE-TOTAL and DECODE-CANONICAL for frames that carry messages.
//= SM2-WIR-001, SM2-PAY-002, SM2-PAY-001 kani
// Shows DECODE-MESSAGE (Samples), bound: 48 bytes and up to 2 of payload.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(52))]
fn message_frames_are_canonical() {
    let carrier = kani::any_where(|kind: &u8| (4..7).contains(kind));
    let form = kani::any_where(|form: &u8| *form < 4);
    let rest = kani::any_where(|rest: &u8| *rest < 3);
    let mut bytes: [u8; MESSAGE_HEAD + 2] = kani::any();
    (bytes[0], bytes[1]) = (carrier, form);
    if kani::any() {
        bytes[3..16].fill(0);
        bytes[40..48].copy_from_slice(&u64::from(rest).to_le_bytes());
    }
    let kind = is_canonical(&bytes[..MESSAGE_HEAD + usize::from(rest)]);
    assert!(kind.is_none() || form < 3, "an unknown form");
    assert!(kind.is_none() || bytes[12..16] == [0; 4], "reserved");
    assert!(
        kind.is_none() || form == 1 || bytes[4..12] == [0; 8],
        "no slot"
    );
    kani::cover!(kind == Some(FrameKind::Data) && rest == 2, "DATA");
    kani::cover!(kind == Some(FrameKind::Reply), "REPLY");
    kani::cover!(kind.is_none(), "not a frame");
}

/// DAT-BOUNDS: no address lies outside its segment, whatever the peer sends.
//= SM2-SEG-003, SM2-PAY-003 kani
// Shows DAT-BOUNDS (BoundariesAndSamples), bound: any stride, slots, slot, length.
#[cfg_attr(kani, kani::proof)]
fn slots_are_inside() {
    let (stride, slots, slot): (u64, u32, u32) = kani::any();
    let len: u64 = kani::any();
    let size = u128::from(stride) * u128::from(slots);
    let Some(geometry) = Geometry::new(stride, slots) else {
        let legal = stride != 0 && stride.is_multiple_of(64) && (1..=SLOTS_MAX).contains(&slots);
        assert!(!legal || size > u128::from(SEGMENT_BYTES_MAX));
        return;
    };
    assert!(size == u128::from(geometry.size_bytes()) && size <= u128::from(SEGMENT_BYTES_MAX));
    let offset = geometry.offset(slot);
    assert_eq!(offset.is_some(), slot < slots);
    kani::cover!(offset.is_none(), "no such slot");
    if let Some(offset) = offset
        && len <= geometry.stride()
    {
        assert!(u128::from(offset) + u128::from(len) <= size);
        kani::cover!(
            offset > 0 && len == stride,
            "a full slot that is not the first"
        );
    }
}

/// DAT-SEALED: no file is accepted without its seals.
//= SM2-SEG-001, SM2-SEG-002, SM2-SEG-003 kani
// Shows DAT-SEALED (BoundariesAndSamples), bound: any facts; segments of one slot of 4,096 bytes.
#[cfg_attr(kani, kani::proof)]
fn only_sealed_files_are_accepted() {
    let facts = FdFacts {
        regular: kani::any(),
        size_bytes: kani::any(),
        // The seals that matter, and all other bits.
        seals: Seals(below(32) as u32 | kani::any::<u32>() << 5),
    };
    let bits = |mask| facts.seals.0 & mask == mask;
    let (sealed, pooled) = (Verified::sealed(&facts), Verified::pooled(&facts));
    assert_eq!(sealed.is_ok(), facts.regular && bits(0x0f));
    assert_eq!(pooled.is_ok(), facts.regular && bits(0x17));
    let size = facts.size_bytes;
    if let Ok(file) = sealed {
        let len = kani::any();
        let fits = len <= size && size <= SEGMENT_BYTES_MAX;
        assert_eq!(file.check_message(len).is_ok(), fits);
        kani::cover!(fits && len > 0, "a sealed message");
    }
    if let (Ok(file), Some(geometry)) = (pooled, Geometry::new(4_096, 1)) {
        assert_eq!(file.check_segment(geometry).is_ok(), size == 4_096);
        kani::cover!(size == 4_096, "a segment");
    }
    kani::cover!(facts.regular && pooled.is_err(), "seals missing");
}

/// Six steps of a receiver: it never has more unreleased messages than its window, and releases
/// each once.
//= SM2-MSG-001, SM2-MSG-003, SM2-MSG-005, SM2-QOS-001 kani
// Shows LNK-WINDOW (Exhaustive), bound: 6 steps from the beginning, depth 1 or 2, inline messages.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(8))]
fn receiver_keeps_to_its_window() {
    let config = Config {
        id: LinkId::FIRST,
        version: crate::VERSION,
        role: Role::Receiver,
        reliable: kani::any(),
        sealed: false,
        ring: false,
        depth: 1 + u16::from(kani::any::<bool>()),
        max_borrowed: 1,
        max_len: MaxLen::GREATEST,
        deadline: Period::NONE,
        lifespan: Period::NONE,
        lease: Period::NONE,
        publications: Publications::UNKNOWN,
    };
    let mut inbound = Inbound::new(&config);
    let (mut came, mut unreleased, mut held) = (0, 0, None);
    for _ in 0..6 {
        match kani::any::<(bool, bool)>() {
            (true, true) => {
                let frame = MessageFrame {
                    carrier: Carrier::Data,
                    form: Form::Inline,
                    status: Status::Ok,
                    sequence: came + 1,
                    id: came + 1,
                    time: Instant(0),
                    len: 0,
                    rest: &[],
                };
                let full = unreleased == config.window();
                kani::cover!(full, "the window is full");
                match inbound.check(&frame, &[]) {
                    Ok(checked) => {
                        assert!(!full);
                        let displaced = inbound.accept(checked);
                        assert!(displaced.is_none() || !config.reliable);
                        kani::cover!(displaced.is_some(), "displaced");
                        (came, unreleased) = (came + 1, unreleased + 1);
                    }
                    Err(it) => assert!(full && it == violation!(WindowExceeded, "SM2-MSG-003")),
                }
            }
            (true, false) => match inbound.take() {
                Ok(Some(delivery)) => {
                    assert!(held.is_none(), "one at a time");
                    held = Some(delivery.sequence);
                }
                Ok(None) => assert_eq!(inbound.untaken(), 0),
                Err(_) => assert!(held.is_some()),
            },
            (false, true) => {
                let sequence = held.take().unwrap_or(1);
                let [before, again] = [(); 2].map(|()| inbound.release(sequence, Given::Consumed));
                assert!(!again, "given back once");
                kani::cover!(before, "given back");
            }
            (false, false) => {
                while let Some(packet) = inbound.poll() {
                    let released = (packet.len_bytes() - 8) / 8;
                    assert!(released > 0 && released <= unreleased as usize);
                    unreleased -= released as u32;
                }
            }
        }
        assert!(unreleased <= config.window());
        inbound.invariants();
    }
}

/// Counts the CLOSE frames, settled messages and failed calls among the outputs of a link's end.
fn last_outputs(link: &mut Link, end: End) -> (u32, u32, u32) {
    let (mut closes, mut settled, mut failed, mut ended) = (0, 0, 0, false);
    while let Some(output) = link.poll() {
        assert!(!ended, "nothing comes behind it");
        match output {
            Output::Transmit(packet) => {
                assert!(packet.head[0] == FrameKind::Close as u8);
                closes += 1;
            }
            Output::Settled { key: 1, .. } => settled += 1,
            Output::CallFailed { call: 1 } => failed += 1,
            Output::Ended(found) => {
                assert_eq!(found, end);
                ended = true;
            }
            _ => panic!("nothing else is due"),
        }
    }
    assert!(ended, "the end is reported");
    (closes, settled, failed)
}

/// LNK-ABSORB: an end that is over returns the pending outputs and at most one CLOSE, and then no
/// output for any input.
//= SM2-OPN-007, SM2-OPN-008, SM2-OPN-009, SM2-SRV-004 kani
// Shows LNK-ABSORB (Exhaustive), bound: any role, phase and end, at most one message.
#[cfg_attr(kani, kani::proof)]
// At most four outputs; twelve kinds of frames; heads of at most 48 bytes.
#[cfg_attr(kani, kani::unwind(50))]
fn an_ended_link_is_silent() {
    let mut link = Link::new(config(role()));
    if kani::any() {
        link.state = Ok(Phase::Open);
        if let lane::Lane::Socket(socket) = &mut link.lane {
            socket.outbound.open(1, MESSAGE_MAX, |_| {});
        }
    }
    (link.open_sent, link.blocked) = kani::any();
    let close = Frame::Close(Code(3)).head();
    let message = OutboundMessage {
        key: 1,
        id: 1,
        time: NOW,
        status: Status::Ok,
        len: 0,
        body: Body::Inline(bytes::Bytes::new()),
    };
    let asks = matches!(link.config.role, Role::Sender | Role::Caller);
    let has_message = asks && kani::any();
    if has_message {
        let sent = link.send(&NoMemory, message.clone(), |_, _| {});
        assert_eq!(sent, Ok(Wake::NotNeeded));
    }
    let violation = End::Violation(violation!(UnknownFrame, "SM2-WIR-001"));
    let (end, input) = match below(5) {
        0 => (End::Eof, Input::Eof),
        1 => (End::Eof, Input::Datagram(Datagram::new(&[]))),
        2 => (End::Local(Code(5)), Input::Close(Code(5))),
        3 => (End::Peer(Code(3)), Input::Datagram(Datagram::new(&close))),
        _ => (violation, Input::Datagram(Datagram::new(&[0xff]))),
    };
    let is_violation = end == violation;
    let verdict = link.handle(NOW, input);
    let expected = is_violation.then_some(Error::Ended(end));
    assert_eq!(verdict.err(), expected);
    let (closes, settled, lost) = last_outputs(&mut link, end);
    let says = matches!(end, End::Local(_) | End::Violation(_)) && !link.blocked;
    let calls = has_message && link.config.role == Role::Caller;
    assert_eq!(closes, u32::from(says));
    assert_eq!((settled, lost), (u32::from(has_message), u32::from(calls)));
    let later = match below(10) {
        0 => link.handle(NOW, Input::Eof),
        1 => link.handle(NOW, Input::Datagram(Datagram::new(&close))),
        2 => link.handle(NOW, Input::Datagram(Datagram::new(&[0xff]))),
        3 => link.send(&NoMemory, message, |_, _| {}).map(drop),
        4 => link.handle(NOW, Input::Drop(Fate::NoRoom)),
        5 => link.release(&NoMemory, 1).map(drop),
        6 => link.handle(NOW, Input::Cancel { call: 1 }),
        7 => link.handle(NOW, Input::Writable),
        8 => link.handle(NOW, Input::Blocked),
        _ => link.handle(NOW, Input::Close(Code(9))),
    };
    assert_eq!(later, Err(Error::Ended(end)));
    assert!(link.poll().is_none() && link.end() == Some(end));
    kani::cover!(closes == 1 && lost == 1, "a call is lost");
    kani::cover!(is_violation && closes == 0, "the socket takes no CLOSE");
}

#[cfg(test)]
kani::explored! {
    link_phase_table: 3,
    fixed_frames_are_canonical: 5,
    each_reserved_byte_is_checked: 2,
    message_frames_are_canonical: 3,
    slots_are_inside: 2,
    only_sealed_files_are_accepted: 3,
    receiver_keeps_to_its_window: 3,
    an_ended_link_is_silent: 2,
}
