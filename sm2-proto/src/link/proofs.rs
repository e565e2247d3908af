//! Harnesses for a link's tables, frames, addresses and windows.

use super::{
    Config, Frame, FrameKind, Role,
    inbound::Inbound,
    phase::{Phase, admit},
    segments::{Geometry, Verified},
    types::Status,
    wire::{Carrier, Form, MessageFrame},
};
use crate::{
    Datagram, FdFacts, Instant, LinkId, Seals, Violation,
    limits::{MESSAGE_HEAD, SEGMENT_BYTES_MAX, SLOTS_MAX},
};

fn role() -> Role {
    Role::ALL[usize::from(kani::any_where(|at: &u8| *at < 4))]
}

//= SM2-OPN-001, SM2-WIR-002 kani
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(11))]
fn link_phase_table() {
    let (role, opening) = (role(), kani::any());
    let phase = if opening { Phase::Opening } else { Phase::Open };
    let Some(kind) = FrameKind::from_number(kani::any()) else {
        return;
    };
    let verdict = admit(phase, role, kind);
    let expected = match kind {
        FrameKind::Close => Ok(()),
        FrameKind::Open if opening => Ok(()),
        FrameKind::Open => Err(Violation::UnexpectedOpen),
        _ if opening => Err(Violation::ExpectedOpen),
        kind if kind.is_received_by(role) => Ok(()),
        _ => Err(Violation::WrongRole),
    };
    assert_eq!(verdict, expected);
    kani::cover!(verdict == Err(Violation::WrongRole), "not for this role");
    kani::cover!(verdict.is_ok() && kind == FrameKind::Reply, "a reply");
}

/// Whatever decodes encodes to the bytes that came.
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

/// Where SPEC section 7 has reserved bytes in the frames without payload.
const RESERVED: [(u8, usize, &[usize]); 6] = [
    (1, 32, &[28, 29, 30, 31]),
    (2, 24, &[1, 2, 3, 20, 21, 22, 23]),
    (3, 8, &[1, 2, 3]),
    (7, 8, &[4, 5, 6, 7]),
    (8, 16, &[1, 2, 3, 4, 5, 6, 7]),
    (9, 8, &[1, 4, 5, 6, 7]),
];

/// DECODE-TOTAL and DECODE-CANONICAL for frames of fixed length.
//= SM2-WIR-001, SM2-TRN-005 kani
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(34))]
fn fixed_frames_are_canonical() {
    let (number, exact, reserved) = RESERVED[usize::from(kani::any::<u8>() % 6)];
    let (other_len, clean): (bool, bool) = kani::any();
    let mut bytes: [u8; 33] = kani::any();
    bytes[0] = number;
    if clean {
        reserved.iter().for_each(|at| bytes[*at] = 0);
        // Often the only fault: one reserved byte.
        bytes[reserved[usize::from(kani::any::<u8>()) % reserved.len()]] = kani::any();
    }
    let len = if other_len {
        usize::from(kani::any::<u8>() % 34)
    } else {
        exact
    };
    let kind = is_canonical(&bytes[..len]);
    if kind.is_some() {
        assert!(reserved.iter().all(|at| bytes[*at] == 0));
        assert!(len == exact || kind == Some(FrameKind::Release));
    }
    kani::cover!(kind == Some(FrameKind::Open), "OPEN");
    kani::cover!(kind == Some(FrameKind::Attach), "ATTACH");
    kani::cover!(kind == Some(FrameKind::Close), "CLOSE");
    kani::cover!(
        kind.is_none() && clean && len == exact,
        "refused in spite of its length"
    );
}

/// DECODE-TOTAL and DECODE-CANONICAL for frames that carry messages.
//= SM2-WIR-001, SM2-PAY-001, SM2-PAY-004 kani
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(52))]
fn message_frames_are_canonical() {
    let carrier = 4 + kani::any::<u8>() % 3;
    let form = kani::any::<u8>() % 4;
    let rest = kani::any::<u8>() % 3;
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

/// DAT-BOUNDS: no address outside the segment, whatever the peer says.
//= SM2-SEG-003, SM2-PAY-002 kani
#[cfg_attr(kani, kani::proof)]
fn slots_are_inside() {
    let (stride, slots, slot): (u64, u32, u32) = kani::any();
    let len: u64 = kani::any();
    let size = u128::from(stride) * u128::from(slots);
    let Some(geometry) = Geometry::new(stride, slots) else {
        let legal = stride != 0 && stride.is_multiple_of(4_096) && (1..=SLOTS_MAX).contains(&slots);
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

/// DAT-SEALED: nothing is mapped without its seals.
//= SM2-SEG-001, SM2-SEG-002, SM2-SEG-003 kani
#[cfg_attr(kani, kani::proof)]
fn only_sealed_files_are_accepted() {
    let facts = FdFacts {
        regular: kani::any(),
        size_bytes: kani::any(),
        seals: Seals(u32::from(kani::any::<u8>()) | kani::any::<u32>() << 8),
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

/// Six steps of a receiver: never more unreleased than its window, all released once.
//= SM2-MSG-001, SM2-MSG-003, SM2-MSG-005, SM2-QOS-001 kani
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(8))]
fn receiver_keeps_to_its_window() {
    let config = Config {
        id: LinkId::FIRST,
        version: crate::VERSION,
        role: Role::Receiver,
        reliable: kani::any(),
        sealed: false,
        depth: 1 + u16::from(kani::any::<bool>()),
        max_borrowed: 1,
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
                    Ok(admitted) => {
                        assert!(!full);
                        let displaced = inbound.accept(admitted);
                        assert!(displaced.is_none() || !config.reliable);
                        kani::cover!(displaced.is_some(), "displaced");
                        (came, unreleased) = (came + 1, unreleased + 1);
                    }
                    Err(violation) => {
                        assert!(full && violation == Violation::WindowExceeded);
                    }
                }
            }
            (true, false) => match inbound.take() {
                Ok(Some(delivery)) => {
                    assert!(held.is_none(), "one at a time");
                    held = Some(delivery.sequence);
                }
                Ok(None) => assert_eq!(inbound.ready(), 0),
                Err(_) => assert!(held.is_some()),
            },
            (false, true) => {
                let sequence = held.take().unwrap_or(1);
                let before = inbound.release(sequence);
                assert!(!inbound.release(sequence), "given back once");
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

#[cfg(test)]
kani::explored! {
    link_phase_table: 2,
    fixed_frames_are_canonical: 4,
    message_frames_are_canonical: 3,
    slots_are_inside: 2,
    only_sealed_files_are_accepted: 3,
    receiver_keeps_to_its_window: 3,
}
