//! Compares two decoders of frames, headers and beacons: the one of the crate, and one written from
//! SPEC alone. Both accept the same bytes with the same meaning, and refuse all others for the same
//! reason.

// Shows GW-DECODE (proptest), bound: sampled frames, headers, beacons and streams, and mutants of them.

use crate::any_gateway_frames as frames;

use crate::gateway::{agreement, json, naive};
use crate::support::{
    cases,
    contracts::{data, name},
    edit::edit,
};
use proptest::{collection::vec, prelude::*};
use sm2_proto::{
    gateway::{BEACON_LEN, Frame, GatewayId, HEADER_LEN, Hop, OfferId, Subject},
    limits::GATEWAY_FRAME_MAX,
};

/// A byte that a frame often has, or any other.
fn likely_byte() -> impl Strategy<Value = u8> {
    prop_oneof![0..9_u8, Just(b'a'), Just(b'/'), Just(0x80), any::<u8>()]
}

/// A field of a header, often with a legal value.
fn field() -> impl Strategy<Value = u64> {
    prop_oneof![
        3 => Just(0),
        2 => 1_u64..8,
        1 => Just(1 << 40),
        1 => Just((1 << 40) + 1),
        1 => any::<u64>(),
    ]
}

proptest! {
    #![proptest_config(cases(500))]

    //= SM2-GWF-002, SM2-GWO-007, SM2-FRM-001, SM2-FRM-002, SM2-NAM-001 test
    #[test]
    fn frames_and_what_is_almost_one(frame in frames::any_frame(), edits in vec(any::<(u16, u8, u8)>(), 0..4)) {
        let mut body = frame.to_bytes().split_off(4);
        prop_assert_eq!(naive::body(&body), Ok(json::frame(&frame)));
        agreement::body(&body);
        for one in edits {
            edit(&mut body, one);
            agreement::body(&body);
        }
    }

    //= SM2-GWO-007 test
    #[test]
    fn paths(hops in vec((0_u8..12, 0_u64..2), 0..10)) {
        let hop = |(gateway, epoch)| Hop { gateway: GatewayId([gateway; 32]), epoch };
        let path = hops.into_iter().map(hop).collect();
        let subject = Subject::Topic { name: name("a"), data: data("A"), reliable: false, latched: 0 };
        let frame = Frame::Offer { offer: OfferId(1), subject, path };
        agreement::body(&frame.to_bytes()[4..]);
    }

    //= SM2-FRM-001 test
    #[test]
    fn cut_short_anywhere(frame in frames::any_frame()) {
        let mut body = frame.to_bytes().split_off(4);
        for len in 1..body.len() {
            prop_assert_eq!(naive::body(&body[..len]), Err("malformed"));
            agreement::body(&body[..len]);
        }
        body.push(0);
        prop_assert_eq!(naive::body(&body), Err("trailing-bytes"));
        agreement::body(&body);
    }

    /// Small numbers are often legal lengths and variants.
    //= SM2-FRM-001, SM2-FRM-002 test
    #[test]
    fn likely_bytes(number in 0_u8..10, bytes in vec(likely_byte(), 0..90)) {
        agreement::body(&bytes);
        agreement::body(&[&[number][..], &bytes].concat());
    }

    //= SM2-GWF-002 test
    #[test]
    fn streams_in_any_pieces(
        frames in vec(frames::any_frame(), 0..5),
        edits in vec(any::<(u16, u8, u8)>(), 0..3),
        pieces in vec(1_usize..60, 1..9),
    ) {
        let mut bytes: Vec<u8> = frames.iter().flat_map(Frame::to_bytes).collect();
        agreement::stream(&bytes, &pieces);
        for one in edits {
            edit(&mut bytes, one);
            agreement::stream(&bytes, &pieces);
        }
    }

    //= SM2-GWM-002, SM2-SRV-002, SM2-PAY-008 test
    #[test]
    fn headers(kind in 0_u64..5, fields in [field(), field(), field(), field()], change in any::<Option<(u8, u8)>>()) {
        let [offer, second, third, len] = fields;
        let mut bytes = [0; HEADER_LEN];
        for (place, field) in bytes.chunks_exact_mut(8).zip([kind, offer, second, third, len]) {
            place.copy_from_slice(&field.to_le_bytes());
        }
        agreement::header(&bytes);
        if let Some((at, byte)) = change {
            bytes[usize::from(at) % HEADER_LEN] = byte;
            agreement::header(&bytes);
        }
    }

    //= SM2-GWD-001 test
    #[test]
    fn beacons(key: [u8; 32], port in 0_u16..3, version in 0_u16..3, edits in vec(any::<(u16, u8, u8)>(), 0..3)) {
        let mut bytes = b"SM2G".to_vec();
        bytes.extend([version, port].iter().flat_map(|it| it.to_le_bytes()));
        bytes.extend(key);
        bytes.resize(BEACON_LEN - 8, 7);
        bytes.resize(BEACON_LEN, 0);
        agreement::beacon(&bytes);
        for one in edits {
            edit(&mut bytes, one);
            agreement::beacon(&bytes);
        }
    }
}

//= SM2-GWF-002 test
#[test]
fn the_longest_frame() {
    for len in [GATEWAY_FRAME_MAX, GATEWAY_FRAME_MAX + 1] {
        let body = vec![1; len];
        agreement::body(&body);
        let prefix = u32::try_from(len).expect("small").to_le_bytes();
        agreement::stream(&[&prefix, &body[..]].concat(), &[5, 4_096]);
    }
}
