//! Harnesses for the bytes of control frames.
//!
//! postcard and serde are not code of this project and are costly for a prover. These harnesses
//! cover short frames, one change of a whole frame, and the fields of frames of fixed shape. All
//! other frames are fuzzed and compared with a naive decoder.

use crate::control::SchemaText;
use alloc::{string::String, vec::Vec};

use super::{
    ToManager, ToNode, decode_to_manager, decode_to_node, encode_to_manager, encode_to_node,
};
use crate::{
    Code, Datagram, FdFacts, InterfaceId, LinkId, LinkKey, Name, NodeId, TypeId,
    limits::SCHEMA_TEXT_MAX,
    proofs::{below, one_of},
};

/// The bytes with any small number of descriptors.
fn datagram<'a>(bytes: &'a [u8], files: &'a [FdFacts; 2], fds: usize) -> Datagram<'a> {
    Datagram {
        fds: &files[..fds],
        ..Datagram::new(bytes)
    }
}

/// DECODE-TOTAL and DECODE-CANONICAL: any two bytes to the Manager.
//= SM2-FRM-001, SM2-FRM-002, SM2-TRN-010 kani
// Shows DECODE-CONTROL (Exhaustive), bound: 2 bytes.
#[cfg_attr(kani, kani::proof)]
// Two bytes; numbers of up to ten.
#[cfg_attr(kani, kani::unwind(12))]
fn short_frames_to_a_manager_are_canonical() {
    let bytes: [u8; 2] = kani::any();
    let len = if matches!(bytes[0], 7 | 9 | 14) { 1 } else { 2 };
    let files = [FdFacts::default(); 2];
    let fds = usize::from(bytes[0] == 9);
    let decoded = decode_to_manager(&datagram(&bytes[..len], &files, fds));
    if bytes[0] >= 16 {
        // Also a number that continues after its first byte: all numbers are small.
        let long = bytes[0] >= 0x80 && bytes[1] == 0;
        assert!(decoded == Err(violation!(UnknownFrame, "SM2-FRM-001")) || long);
    }
    if let Ok(frame) = &decoded {
        assert!(encode_to_manager(frame) == bytes[..len]);
        assert!(matches!(bytes[0], 2 | 4 | 5 | 7..=10 | 13..=15));
    }
    kani::cover!(decoded == Ok(ToManager::Counters), "COUNTERS");
    kani::cover!(matches!(decoded, Ok(ToManager::Goodbye { .. })), "GOODBYE");
    kani::cover!(
        decoded == Err(violation!(Malformed, "SM2-FRM-001")),
        "a frame that is cut off"
    );
}

/// DECODE-TOTAL and DECODE-CANONICAL: any two bytes to a node.
//= SM2-FRM-001, SM2-FRM-002, SM2-TRN-010 kani
// Shows DECODE-CONTROL (Exhaustive), bound: 2 bytes.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(12))]
fn short_frames_to_a_node_are_canonical() {
    let bytes: [u8; 2] = kani::any();
    let files = [FdFacts::default(); 2];
    let fds = usize::from(bytes[0] == 10);
    let decoded = decode_to_node(&datagram(&bytes, &files, fds));
    if bytes[0] >= 15 {
        let long = bytes[0] >= 0x80 && bytes[1] == 0;
        assert!(decoded == Err(violation!(UnknownFrame, "SM2-FRM-001")) || long);
    }
    if let Ok(frame) = &decoded {
        assert!(encode_to_node(frame) == bytes);
        assert!(matches!(bytes[0], 1 | 6 | 8 | 10 | 11 | 14));
    }
    kani::cover!(matches!(decoded, Ok(ToNode::Inspected { .. })), "INSPECTED");
    kani::cover!(
        matches!(decoded, Ok(ToNode::HelloRefused { .. })),
        "HELLO_REFUSED"
    );
    kani::cover!(
        decoded == Err(violation!(Malformed, "SM2-FRM-001")),
        "a frame that is cut off"
    );
}

fn name() -> Name {
    Name::new("a").expect("a legal name")
}

fn data() -> TypeId {
    let name = name();
    TypeId { name, hash: 1 }
}

/// A frame of each type that has no contract, with any numbers.
fn any_frame() -> ToManager {
    let (interface, code) = (InterfaceId(any_number()), Code(any_number() as u16));
    let link = LinkId {
        epoch: any_number(),
        serial: 0,
    };
    match below(13) {
        0 => ToManager::Hello {
            min_version: code.0,
            max_version: 1,
            name: name(),
            resuming: kani::any(),
        },
        1 => ToManager::Withdraw { interface },
        2 => ToManager::Unlinked {
            interface,
            link,
            code,
        },
        3 => ToManager::Query { after: None },
        4 => ToManager::Goodbye { code },
        5 => ToManager::Claim {
            interface,
            link,
            key: LinkKey(u64::MAX),
            version: code.0,
            reliable: kani::any(),
            sealed: kani::any(),
        },
        6 => ToManager::Claimed,
        7 => ToManager::Watch { after: interface.0 },
        8 => ToManager::Counters,
        9 => ToManager::Schema(SchemaText {
            data: data(),
            text: String::new(),
        }),
        10 => ToManager::Describe { data: data() },
        11 => ToManager::Reload,
        _ => ToManager::Suspended { interface },
    }
}

/// The values where the length of a number changes.
fn any_number() -> u64 {
    one_of(&[0, 127, 128, 16_383, 16_384, u64::MAX])
}

/// A frame is read back unchanged. It is refused with one byte more or less, another number of
/// descriptors, or a number that is longer than necessary.
//= SM2-FRM-001, SM2-FRM-002, SM2-TRN-010 kani
// Shows DECODE-CONTROL (Exhaustive), bound: 11 of 13 types to the Manager (not DECLARE and INSPECT), numbers where
// their length changes.
#[cfg_attr(kani, kani::proof)]
// Frames of at most 40 bytes.
#[cfg_attr(kani, kani::unwind(42))]
fn frames_are_read_exactly() {
    let frame = any_frame();
    let mut bytes: Vec<u8> = encode_to_manager(&frame);
    let files = [FdFacts::default(); 2];
    let wanted = usize::from(frame == ToManager::Counters);
    let expected = match below(5) {
        0 => Ok(frame),
        1 => {
            bytes.push(one_of(&[0, 1, 0x80, 0xff]));
            Err(violation!(TrailingBytes, "SM2-FRM-001"))
        }
        2 => {
            bytes.pop();
            let nothing = bytes.is_empty();
            Err(if nothing {
                violation!(UnknownFrame, "SM2-FRM-001")
            } else {
                violation!(Malformed, "SM2-FRM-001")
            })
        }
        3 => {
            // The frame's own number in two bytes.
            bytes[0] |= 0x80;
            bytes.insert(1, 0);
            Err(violation!(NotCanonical, "SM2-FRM-002"))
        }
        _ => {
            let fds = kani::any_where(|fds: &u8| *fds < 3 && usize::from(*fds) != wanted);
            let decoded = decode_to_manager(&datagram(&bytes, &files, usize::from(fds)));
            assert_eq!(decoded, Err(violation!(FdCount, "SM2-TRN-010")));
            kani::cover!(fds == 2 && wanted == 1, "two instead of one");
            return;
        }
    };
    let decoded = decode_to_manager(&datagram(&bytes, &files, wanted));
    kani::cover!(bytes.len() > 24 && decoded.is_ok(), "a long frame");
    kani::cover!(
        decoded == Err(violation!(NotCanonical, "SM2-FRM-002")),
        "a number that is too long"
    );
    assert_eq!(decoded, expected);
}

/// A schema text may have 32,768 bytes, and not one more, in either direction.
//= SM2-SCH-001 kani
// Shows DECODE-CONTROL (Exhaustive), bound: lengths 32,767 to 32,769.
#[cfg_attr(kani, kani::proof)]
// 32,769 bytes.
#[cfg_attr(kani, kani::unwind(32_800))]
fn schema_texts_have_their_length() {
    let len = SCHEMA_TEXT_MAX - 1 + below(3);
    let text = String::from_utf8(alloc::vec![b'x'; len]).expect("ASCII");
    let is_legal = len <= 32_768;
    let verdict = if kani::any() {
        let data = data();
        let frame = encode_to_manager(&ToManager::Schema(SchemaText { data, text }));
        decode_to_manager(&Datagram::new(&frame)).map(drop)
    } else {
        let (data, text) = (data(), Some(text));
        let frame = encode_to_node(&ToNode::Described { data, text });
        decode_to_node(&Datagram::new(&frame)).map(drop)
    };
    let expected = if is_legal {
        Ok(())
    } else {
        Err(violation!(BadSchema, "SM2-SCH-001"))
    };
    assert_eq!(verdict, expected);
    kani::cover!(is_legal && len == SCHEMA_TEXT_MAX, "the longest text");
    kani::cover!(!is_legal, "one byte too long");
}

/// The numbers of nodes are read in full length from a frame.
//= SM2-FRM-001 kani
// Shows DECODE-CONTROL (BoundariesAndSamples), bound: any number.
#[cfg_attr(kani, kani::proof)]
#[cfg_attr(kani, kani::unwind(12))]
fn numbers_come_back() {
    let node = NodeId(kani::any());
    let bytes = encode_to_manager(&ToManager::Inspect { node });
    assert_eq!(
        decode_to_manager(&Datagram::new(&bytes)),
        Ok(ToManager::Inspect { node })
    );
    assert!(bytes.len() <= 11);
    kani::cover!(bytes.len() == 11, "the longest number");
    kani::cover!(bytes.len() == 2, "a short number");
}

#[cfg(test)]
kani::explored! {
    short_frames_to_a_manager_are_canonical: 3,
    short_frames_to_a_node_are_canonical: 3,
    frames_are_read_exactly: 3,
    schema_texts_have_their_length: 2,
    numbers_come_back: 2,
}
