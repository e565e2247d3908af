//! The encodings of frames of the control stream and of headers.

// Shows GW-DECODE (proptest), bound: each frame and outcome by hand; sampled frames, changed and cut bytes.

use crate::any_gateway_frames::any_frame;
use crate::support::{
    cases,
    contracts::{data, name},
};
use proptest::{collection::vec, prelude::*};
use sm2_proto::{
    gateway::{
        AskId, Frame, FrameReader, GatewayId, HEADER_LEN, Header, HeaderKind, Hop, OfferId,
        Outcome, PeerViolationKind, Subject, SubjectKind, Verdict,
    },
    limits::{GATEWAY_FRAME_MAX, HOPS_MAX, MESSAGE_MAX},
    violation,
};

fn hop(gateway: u8) -> Hop {
    Hop {
        gateway: GatewayId([gateway; 32]),
        epoch: 3,
    }
}

fn topic() -> Subject {
    Subject::Topic {
        name: name("scan"),
        data: data("Scan"),
        reliable: true,
        latched: 300,
    }
}

fn offer(path: Vec<Hop>) -> Frame {
    let (offer, subject) = (300, topic());
    Frame::Offer {
        offer: OfferId(offer),
        subject,
        path,
    }
}

/// The bytes of each frame, written by hand from SPEC.
//= SM2-GWF-002, SM2-FRM-002 test
#[test]
fn the_bytes_of_each_frame() {
    let mut offered = vec![52, 0, 0, 0, 1, 0xac, 2, 0, 4];
    offered.extend(b"scan\x04Scan\x07\x01\xac\x02\x01");
    offered.extend([9; 32]);
    offered.push(3);
    let service = Frame::Offer {
        offer: OfferId(1),
        subject: Subject::Service {
            name: name("add"),
            request: data("A"),
            reply: data("B"),
        },
        path: vec![hop(1)],
    };
    let mut serving = vec![47, 0, 0, 0, 1, 1, 1, 3];
    serving.extend(b"add\x01A\x07\x01B\x07\x01");
    serving.extend([1; 32]);
    serving.push(3);
    let hello = Frame::Hello {
        min_version: 1,
        max_version: 2,
        epoch: 128,
        name: name("arm"),
    };
    let ask = Frame::Ask {
        ask: AskId(1),
        kind: SubjectKind::Service,
        name: name("a"),
    };
    let answer = |verdict| Frame::Answer {
        ask: AskId(1),
        verdict,
    };
    let table = [
        (hello, b"\x09\0\0\0\0\x01\x02\x80\x01\x03arm".to_vec()),
        (offer(vec![hop(9)]), offered),
        (service, serving),
        (
            Frame::Unoffer { offer: OfferId(1) },
            b"\x02\0\0\0\x02\x01".to_vec(),
        ),
        (
            Frame::Unoffered { offer: OfferId(1) },
            b"\x02\0\0\0\x03\x01".to_vec(),
        ),
        (
            Frame::Want {
                offer: OfferId(1),
                depth: 4,
            },
            b"\x03\0\0\0\x04\x01\x04".to_vec(),
        ),
        (
            Frame::Unwant { offer: OfferId(1) },
            b"\x02\0\0\0\x05\x01".to_vec(),
        ),
        (
            Frame::Unwanted { offer: OfferId(1) },
            b"\x02\0\0\0\x06\x01".to_vec(),
        ),
        (ask, b"\x05\0\0\0\x07\x01\x01\x01a".to_vec()),
        (answer(Verdict::Offered), b"\x03\0\0\0\x08\x01\0".to_vec()),
        (answer(Verdict::Denied), b"\x03\0\0\0\x08\x01\x01".to_vec()),
        (answer(Verdict::Absent), b"\x03\0\0\0\x08\x01\x02".to_vec()),
    ];
    for (frame, bytes) in table {
        assert_eq!(frame.to_bytes(), bytes, "{frame:?}");
        assert_eq!(Frame::from_body(&bytes[4..]), Ok(frame));
    }
}

//= SM2-GWF-002, SM2-GWO-007, SM2-FRM-001, SM2-FRM-002, SM2-NAM-001 test
#[test]
fn bodies_that_are_refused() {
    let table: [(&[u8], &str); 16] = [
        (b"", "unknown-frame (SM2-FRM-001)"),
        (b"\x09\x01", "unknown-frame (SM2-FRM-001)"),
        (b"\x82", "unknown-frame (SM2-FRM-001)"),
        (b"\x02", "malformed (SM2-FRM-001)"),
        (b"\x08\x01\x03", "malformed (SM2-FRM-001)"),
        (b"\x07\x01\x02\x01a", "malformed (SM2-FRM-001)"),
        (b"\x07\x01\0\x01", "malformed (SM2-FRM-001)"),
        (b"\x02\x01\0", "trailing-bytes (SM2-FRM-001)"),
        (b"\x02\x81\0", "not-canonical (SM2-FRM-002)"),
        (b"\x82\0\x01", "not-canonical (SM2-FRM-002)"),
        (b"\x07\x01\0\0", "bad-name (SM2-NAM-001)"),
        (b"\x07\x01\0\x01.", "bad-name (SM2-NAM-001)"),
        (b"\x07\x01\0\x02\xc3\xa4", "bad-name (SM2-NAM-001)"),
        (b"\x07\x01\0\x01\xff", "bad-name (SM2-FRM-001)"),
        (b"\x04\x01\0", "bad-qos (SM2-GWO-007)"),
        (b"\x04\x01\x81\x08", "bad-qos (SM2-GWO-007)"),
    ];
    for (body, expected) in table {
        let refused = Frame::from_body(body).expect_err("it is refused");
        assert_eq!(refused.to_string(), expected, "{body:x?}");
    }
    let most = Frame::Want {
        offer: OfferId(1),
        depth: 1_024,
    };
    assert_eq!(Frame::from_body(&most.to_bytes()[4..]), Ok(most));
    let longest: Vec<Hop> = (0..HOPS_MAX as u8).map(hop).collect();
    let too_long: Vec<Hop> = (0..=HOPS_MAX as u8).map(hop).collect();
    let again = Hop { epoch: 4, ..hop(1) };
    for (path, is_legal) in [
        (vec![], false),
        (vec![hop(1)], true),
        (longest, true),
        (too_long, false),
        (vec![hop(1), hop(2), hop(1)], false),
        (vec![hop(1), again], false),
    ] {
        let frame = offer(path);
        let expected = if is_legal {
            Ok(frame.clone())
        } else {
            Err(violation!(PeerViolationKind::BadPath, "SM2-GWO-007"))
        };
        assert_eq!(Frame::from_body(&frame.to_bytes()[4..]), expected);
    }
}

//= SM2-GWF-002 test
#[test]
fn lengths_of_frames() {
    let read = |bytes: &[u8]| {
        let mut reader = FrameReader::default();
        reader.push(bytes);
        reader.next_frame()
    };
    assert_eq!(
        read(&[0, 0, 0, 0]),
        Err(violation!(PeerViolationKind::Malformed, "SM2-GWF-002"))
    );
    // The length is refused before the body arrives.
    let longest = GATEWAY_FRAME_MAX as u32;
    assert_eq!(read(&longest.to_le_bytes()), Ok(None));
    let too_long = (longest + 1).to_le_bytes();
    assert_eq!(
        read(&too_long),
        Err(violation!(PeerViolationKind::FrameTooLong, "SM2-GWF-002"))
    );
    assert_eq!(read(&too_long[..3]), Ok(None));
    let body = vec![0; GATEWAY_FRAME_MAX + 1];
    assert_eq!(
        Frame::from_body(&body),
        Err(violation!(PeerViolationKind::FrameTooLong, "SM2-GWF-002"))
    );
    assert_eq!(
        Frame::from_body(&body[1..]),
        Err(violation!(PeerViolationKind::BadName, "SM2-NAM-001"))
    );
}

proptest! {
    #![proptest_config(cases(300))]

    /// The reader returns the same frames for pieces of any length.
    //= SM2-GWF-002 test
    #[test]
    fn frames_go_there_in_pieces(frames in vec(any_frame(), 0..8), pieces in vec(1_usize..40, 1..20)) {
        let bytes: Vec<u8> = frames.iter().flat_map(Frame::to_bytes).collect();
        let mut reader = FrameReader::default();
        let mut read = vec![];
        let (mut rest, mut pieces) = (&bytes[..], pieces.iter().cycle());
        while !rest.is_empty() {
            let (piece, behind) = rest.split_at(rest.len().min(*pieces.next().unwrap()));
            reader.push(piece);
            while let Some(frame) = reader.next_frame().unwrap() {
                read.push(frame);
            }
            rest = behind;
        }
        prop_assert_eq!(read, frames);
        prop_assert!(reader.is_between_frames());
    }

    /// Random bytes are refused, or are the only encoding of a frame.
    //= SM2-FRM-001, SM2-FRM-002 test
    #[test]
    fn no_other_bytes_are_frames(frame in any_frame(), at in any::<prop::sample::Index>(), byte: u8, cut: bool) {
        let mut body = frame.to_bytes().split_off(4);
        let at = at.index(body.len());
        if cut {
            body.truncate(at);
            prop_assert!(Frame::from_body(&body).is_err());
        } else {
            body[at] = byte;
            if let Ok(other) = Frame::from_body(&body) {
                prop_assert_eq!(&other.to_bytes()[4..], &body[..]);
            }
        }
    }
}

fn message(len: u64) -> Header {
    Header {
        kind: HeaderKind::Message {
            sequence: 0x0102_0304_0506_0708,
            age_ns: 9,
        },
        offer: OfferId(5),
        len,
    }
}

//= SM2-GWM-002 test
#[test]
fn the_bytes_of_a_header() {
    let mut expected = [0; HEADER_LEN];
    expected[0] = 1;
    expected[8] = 5;
    expected[16..24].copy_from_slice(&[8, 7, 6, 5, 4, 3, 2, 1]);
    expected[24] = 9;
    expected[33] = 2;
    assert_eq!(message(512).to_bytes(), expected);
    let request = Header {
        kind: HeaderKind::Request { left_ns: 7 },
        offer: OfferId(1),
        len: 0,
    };
    let mut expected = [0; HEADER_LEN];
    (expected[0], expected[8], expected[24]) = (2, 1, 7);
    assert_eq!(request.to_bytes(), expected);
    assert_eq!(Header::from_bytes(&expected), Ok(request));
}

//= SM2-GWM-002, SM2-SRV-002, SM2-PAY-008 test
#[test]
fn headers_that_are_refused() {
    for (number, status) in (0..).zip(Outcome::ALL) {
        for len in [0, 1, MESSAGE_MAX, MESSAGE_MAX + 1] {
            let header = Header {
                kind: HeaderKind::Reply { status },
                offer: OfferId(1),
                len,
            };
            let bytes = header.to_bytes();
            assert_eq!(u64::from(bytes[16]), number);
            let is_legal = len == 0 || (number < 2 && len <= MESSAGE_MAX);
            let expected = if is_legal {
                Ok(header)
            } else {
                Err(violation!(PeerViolationKind::BadLength, "SM2-GWM-002"))
            };
            assert_eq!(Header::from_bytes(&bytes), expected, "{header:?}");
        }
    }
    let longest = message(MESSAGE_MAX);
    assert_eq!(Header::from_bytes(&longest.to_bytes()), Ok(longest));
    let too_long = message(MESSAGE_MAX + 1).to_bytes();
    assert_eq!(
        Header::from_bytes(&too_long),
        Err(violation!(PeerViolationKind::BadLength, "SM2-GWM-002"))
    );
    for (place, byte) in [(0, 0), (0, 4), (1, 1), (7, 128)] {
        let mut bytes = message(0).to_bytes();
        bytes[place] = byte;
        assert_eq!(
            Header::from_bytes(&bytes),
            Err(violation!(PeerViolationKind::Malformed, "SM2-GWM-002"))
        );
    }
    // Unused fields have to be zero: `sequence` of a request, `age` of a reply.
    let mut request = message(0).to_bytes();
    request[0] = 2;
    assert_eq!(
        Header::from_bytes(&request),
        Err(violation!(PeerViolationKind::Malformed, "SM2-GWM-002"))
    );
    for (place, byte) in [(16, 6), (17, 1), (24, 1), (31, 1)] {
        let mut reply = [0; HEADER_LEN];
        reply[0] = 3;
        assert!(Header::from_bytes(&reply).is_ok());
        reply[place] = byte;
        assert_eq!(
            Header::from_bytes(&reply),
            Err(violation!(PeerViolationKind::Malformed, "SM2-GWM-002"))
        );
    }
}
