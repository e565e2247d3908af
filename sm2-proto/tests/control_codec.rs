//! The codec of control frames. Every frame decodes to itself, every other datagram is refused with
//! the right violation, and a second decoder agrees on both.

// Shows DECODE-CONTROL (proptest), bound: sampled frames, and mutants of them.

use crate::frames;
use crate::naive;
use crate::support;

use crate::direction::{TO_MANAGER, TO_NODE, datagram, json};
use crate::support::{bench::hello, cases};
use proptest::{collection::vec, prelude::*};
use sm2_proto::{
    Contract, Datagram, Name,
    control::{
        ToManager, ToNode, decode_to_manager, decode_to_node, encode_to_manager, encode_to_node,
    },
    limits::{DATAGRAM_MAX, NAME_MAX, SCHEMA_TEXT_MAX},
    violation,
};

proptest! {
    #![proptest_config(cases(400))]

    //= SM2-FRM-001, SM2-FRM-002 test
    #[test]
    fn there_and_back_to_the_manager(frame in frames::to_manager()) {
        let bytes = encode_to_manager(&frame);
        prop_assert!(bytes.len() < DATAGRAM_MAX);
        let own = usize::from(frame == ToManager::Counters);
        for fds in 0..=3 {
            let decoded = decode_to_manager(&datagram(&bytes, fds));
            let expected = if fds == own { Ok(frame.clone()) } else { Err(violation!(FdCount, "SM2-TRN-010")) };
            prop_assert_eq!(decoded, expected);
        }
        prop_assert_eq!(naive::to_manager(&bytes, own, false), Ok(json(&frame)));
    }

    //= SM2-FRM-001, SM2-FRM-002, SM2-TRN-010 test
    #[test]
    fn there_and_back_to_the_node(frame in frames::to_node()) {
        let bytes = encode_to_node(&frame);
        let own = usize::from(matches!(frame, ToNode::Link { .. } | ToNode::Inspected { .. }));
        for fds in 0..=3 {
            let decoded = decode_to_node(&datagram(&bytes, fds));
            let expected = if fds == own { Ok(frame.clone()) } else { Err(violation!(FdCount, "SM2-TRN-010")) };
            prop_assert_eq!(decoded, expected);
        }
        prop_assert_eq!(naive::to_node(&bytes, own, false), Ok(json(&frame)));
    }

    //= SM2-FRM-001, SM2-FRM-002, SM2-FRM-003, SM2-NAM-001 test
    #[test]
    fn arbitrary_bytes(bytes in vec(any::<u8>(), 0..200), number in 0..14_u8, fds in 0..3_usize) {
        TO_MANAGER.agrees(&bytes, fds)?;
        TO_NODE.agrees(&bytes, fds)?;
        let framed = [&[number][..], &bytes].concat();
        TO_MANAGER.agrees(&framed, fds)?;
        TO_NODE.agrees(&framed, fds)?;
    }

    /// Small numbers are lengths and variants that exist.
    //= SM2-FRM-001, SM2-FRM-002 test
    #[test]
    fn likely_bytes(bytes in vec(prop_oneof![0..14_u8, Just(b'a'), Just(b'/'), Just(0x80)], 1..60)) {
        TO_MANAGER.agrees(&bytes, (TO_MANAGER.fds)(&bytes))?;
        TO_NODE.agrees(&bytes, (TO_NODE.fds)(&bytes))?;
    }

    //= SM2-FRM-001, SM2-FRM-002, SM2-FRM-003, SM2-NAM-001 test
    #[test]
    fn mutants(
        one in frames::to_manager(),
        other in frames::to_node(),
        edits in vec(any::<(u16, u8, u8)>(), 1..4),
    ) {
        TO_MANAGER.mutants_agree(&encode_to_manager(&one), &edits)?;
        TO_NODE.mutants_agree(&encode_to_node(&other), &edits)?;
    }

    //= SM2-FRM-001 test
    #[test]
    fn cut_short_anywhere(one in frames::to_manager(), other in frames::to_node()) {
        for (direction, bytes) in [
            (TO_MANAGER, encode_to_manager(&one)),
            (TO_NODE, encode_to_node(&other)),
        ] {
            for len in 1..bytes.len() {
                prop_assert_eq!(direction.violation(&bytes[..len]), Some(violation!(Malformed, "SM2-FRM-001")));
            }
            prop_assert_eq!(direction.violation(&[]), Some(violation!(UnknownFrame, "SM2-FRM-001")));
            let longer = [&bytes[..], &[0]].concat();
            prop_assert_eq!(direction.violation(&longer), Some(violation!(TrailingBytes, "SM2-FRM-001")));
        }
    }
}

fn hello_named(text: &[u8]) -> Vec<u8> {
    let mut len = Vec::new();
    let mut rest = text.len();
    while rest >= 0x80 {
        len.push(u8::try_from(rest % 0x80).expect("seven bits") | 0x80);
        rest /= 0x80;
    }
    len.push(u8::try_from(rest).expect("seven bits"));
    [&[0, 1, 1], &len[..], text, &[0]].concat()
}

//= SM2-NAM-001 test
#[test]
fn names() {
    let longest = "a".repeat(NAME_MAX);
    let good = [
        "a",
        "A",
        "0",
        "_",
        "-",
        "a/b",
        "-/_",
        "a/b/c/d",
        "Arm_2/joint-7",
        &longest,
    ];
    for text in good {
        assert_eq!(
            TO_MANAGER.violation(&hello_named(text.as_bytes())),
            None,
            "{text}"
        );
        assert_eq!(
            Name::new(text).map(|name| name.to_string()),
            Ok(text.to_owned())
        );
        assert_eq!(Name::typed(&format!("/{text}")), Name::new(text));
    }
    // Names are equal when their bytes are: no case, no normal form.
    assert_ne!(Name::new("Arm"), Name::new("arm"));
    assert!(
        Name::typed("//arm").is_err(),
        "one slash is dropped, not two"
    );
}

//= SM2-NAM-001 test
#[test]
fn bad_names() {
    let too_long = "a".repeat(NAME_MAX + 1);
    let bad: [&[u8]; 29] = [
        b"",
        b"/",
        b"//",
        b"/a",
        b"a/",
        b"a//b",
        b"a/b/",
        b".",
        b"..",
        b"a/../b",
        b"a/./b",
        b"a\0",
        b"\0",
        b"a b",
        b" a",
        b"a\n",
        b"a.b",
        b"a~",
        b"a:b",
        b"a\\b",
        b"a*",
        b"{a}",
        "\u{e4}".as_bytes(),
        "a\u{308}".as_bytes(),
        "\u{2215}".as_bytes(),
        b"\xff",
        b"a\xc0\xafb",
        b"a\x80",
        too_long.as_bytes(),
    ];
    for text in bad {
        let frame = hello_named(text);
        let expected = match str::from_utf8(text) {
            Ok(_) => violation!(BadName, "SM2-NAM-001"),
            Err(_) => violation!(BadName, "SM2-FRM-001"),
        };
        assert_eq!(TO_MANAGER.violation(&frame), Some(expected), "{text:?}");
        if let Ok(text) = std::str::from_utf8(text) {
            assert!(Name::new(text).is_err(), "{text:?}");
        }
    }
}

//= SM2-FRM-002 test
#[test]
fn only_the_shortest_varint() {
    let withdraw = |number: &[u8]| TO_MANAGER.violation(&[&[2], number].concat());
    assert_eq!(withdraw(&[0x7f]), None);
    assert_eq!(withdraw(&[0x80, 1]), None);
    assert_eq!(
        withdraw(&[0xff; 9].iter().copied().chain([1]).collect::<Vec<_>>()),
        None
    );
    for longer in [&[0x80, 0][..], &[0xff, 0], &[0x81, 0x80, 0], &[0x80; 9]] {
        let longer = if longer.len() == 9 {
            [longer, &[0]].concat()
        } else {
            longer.to_vec()
        };
        assert_eq!(
            withdraw(&longer),
            Some(violation!(NotCanonical, "SM2-FRM-002")),
            "{longer:?}"
        );
    }
    // A number with more bytes than its type can need, or with bits beyond it, is out of range.
    let too_long = [[0x80; 10].as_slice(), &[0]].concat();
    let too_large = [[0xff; 9].as_slice(), &[2]].concat();
    for number in [too_long, too_large] {
        assert_eq!(
            withdraw(&number),
            Some(violation!(Malformed, "SM2-FRM-001")),
            "{number:?}"
        );
    }
    let goodbye = |number: &[u8]| TO_MANAGER.violation(&[&[5], number].concat());
    assert_eq!(goodbye(&[0xff, 0xff, 3]), None);
    assert_eq!(
        goodbye(&[0x80, 0x80, 0]),
        Some(violation!(NotCanonical, "SM2-FRM-002"))
    );
    assert_eq!(
        goodbye(&[0xff, 0xff, 4]),
        Some(violation!(Malformed, "SM2-FRM-001"))
    );
    assert_eq!(
        goodbye(&[0x80, 0x80, 0x80, 0]),
        Some(violation!(Malformed, "SM2-FRM-001"))
    );
    // The number of the frame, the length of a name and of a list as well.
    for frame in [&[0x82, 0, 7][..], &[0, 1, 1, 0x81, 0, b'a', 0]] {
        assert_eq!(
            TO_MANAGER.violation(frame),
            Some(violation!(NotCanonical, "SM2-FRM-002"))
        );
    }
    assert_eq!(
        TO_NODE.violation(&[7, 1, 0x80, 0, 0]),
        Some(violation!(NotCanonical, "SM2-FRM-002"))
    );
}

//= SM2-FRM-001 test
#[test]
fn unknown_numbers() {
    for (frames, direction) in [(16_u8, TO_MANAGER), (15, TO_NODE)] {
        for number in frames..=0xff {
            // From 0x80 on the number is cut short; with one more byte it is large.
            assert_eq!(
                direction.violation(&[number]),
                Some(violation!(UnknownFrame, "SM2-FRM-001"))
            );
            assert_eq!(
                direction.violation(&[number, 1]),
                Some(violation!(UnknownFrame, "SM2-FRM-001"))
            );
        }
        let numbers = [
            &[0xff, 0xff, 0xff, 0xff, 0x0f][..],
            &[0xff, 0xff, 0xff, 0xff, 0x1f],
        ];
        for number in numbers {
            assert_eq!(
                direction.violation(number),
                Some(violation!(UnknownFrame, "SM2-FRM-001"))
            );
        }
    }
    for (direction, frame) in [
        (TO_MANAGER, &[1, 1, 4][..]),            // a contract
        (TO_MANAGER, &[4, 2]),                   // an optional value
        (TO_NODE, &[1, 5]),                      // a refusal
        (TO_NODE, &[1, 4, 6, 0]),                // a quota
        (TO_NODE, &[7, 0, 1, 7]),                // an item
        (TO_NODE, &[4, 1, 1, 1, 1, 1, 2, 0]),    // a boolean
        (TO_MANAGER, &[4, 1, 5]),                // a key
        (TO_NODE, &[9, 0, 1, 1, 2]),             // a change
        (TO_NODE, &[9, 0, 2]),                   // an optional value
        (TO_NODE, &[7, 0, 1, 6, 0, 0, 0, 0, 3]), // why a pair is not linked
        (TO_NODE, &[7, 0, 0x80, 0x80, 4, 0]),    // a list longer than the datagram
    ] {
        assert_eq!(
            direction.violation(frame),
            Some(violation!(Malformed, "SM2-FRM-001")),
            "{frame:?}"
        );
    }
}

fn declare(alter: impl Fn(&mut Contract)) -> Vec<u8> {
    let mut contract = support::contracts::publisher("t", &support::contracts::data("T"));
    alter(&mut contract);
    encode_to_manager(&ToManager::Declare {
        interface: sm2_proto::InterfaceId(1),
        contract,
    })
}

//= SM2-FRM-003 test
#[test]
fn quality_of_service() {
    let t = support::contracts::data("T");
    let contract = |kind, depth, second| match kind {
        0 => {
            let mut contract = support::contracts::publisher("t", &t);
            if let Contract::Publisher { offer, .. } = &mut contract {
                (offer.depth, offer.latched) = (depth, second);
            }
            contract
        }
        1 => {
            let mut contract = support::contracts::subscriber("t", None);
            if let Contract::Subscriber { demand, .. } = &mut contract {
                (demand.depth, demand.max_borrowed) = (depth, second);
            }
            contract
        }
        _ => {
            let mut contract = if kind == 2 {
                support::contracts::server("t", &t, &t)
            } else {
                support::contracts::client("t", None)
            };
            if let Contract::Server { qos, .. } | Contract::Client { qos, .. } = &mut contract {
                (qos.depth, qos.max_borrowed) = (depth, second);
            }
            contract
        }
    };
    for kind in 0..4 {
        for depth in [0, 1, 1_024, 1_025, u16::MAX] {
            for second in [0, 1, 1_024, 1_025, u16::MAX] {
                let bytes = declare(|it| *it = contract(kind, depth, second));
                let least = u16::from(kind != 0);
                let good = (1..=1_024).contains(&depth) && (least..=1_024).contains(&second);
                let expected = (!good).then_some(violation!(BadQos, "SM2-FRM-003"));
                assert_eq!(
                    TO_MANAGER.violation(&bytes),
                    expected,
                    "{kind} {depth} {second}"
                );
            }
        }
    }
}

//= SM2-SCH-001, SM2-SCH-002 test
#[test]
fn texts() {
    let frames = |text: &[u8]| {
        let len = [
            0x80 | (text.len() % 0x80) as u8,
            0x80 | (text.len() / 0x80 % 0x80) as u8,
        ];
        let len = [&len[..], &[(text.len() / 0x4000) as u8]].concat();
        let data = [1, b'T', 7];
        [
            (TO_MANAGER, [&[11], &data[..], &len, text].concat()),
            (TO_NODE, [&[12], &data[..], &[1], &len, text].concat()),
        ]
    };
    let long = "x".repeat(SCHEMA_TEXT_MAX);
    let longer = "x".repeat(SCHEMA_TEXT_MAX + 1);
    let mut no_text = long.clone().into_bytes();
    no_text[77] = 0xff;
    for (text, violation) in [
        (long.as_bytes(), None),
        (
            longer.as_bytes(),
            Some(violation!(BadSchema, "SM2-SCH-001")),
        ),
        (&no_text, Some(violation!(BadName, "SM2-FRM-001"))),
    ] {
        for (direction, bytes) in frames(text) {
            assert_eq!(direction.violation(&bytes), violation);
        }
    }
    // The end of the datagram comes before the limit of texts.
    let [(to_manager, mut bytes), _] = frames(longer.as_bytes());
    bytes.push(0);
    assert_eq!(
        to_manager.violation(&bytes),
        Some(violation!(TrailingBytes, "SM2-FRM-001"))
    );
}

/// If a datagram breaks several rules, the first one in the order of SPEC section 10 is named.
//= SM2-COD-001 test
#[test]
fn precedence() {
    let [too_deep, reliable] = [false, true].map(|is_reliable| {
        declare(|contract| {
            if let Contract::Publisher { offer, .. } = contract {
                offer.depth = 0;
                offer.reliable = is_reliable;
            }
        })
    });
    let mut flag = too_deep.iter().zip(&reliable);
    let flag = flag.position(|(one, other)| one != other).unwrap();
    let mut not_canonical = too_deep.clone();
    not_canonical.splice(1..2, [0x81, 0]);
    let mut trailing = not_canonical.clone();
    trailing.push(0);
    // A bool follows the illegal depth: encodings are checked before ranges.
    let mut malformed = trailing.clone();
    // The splice has put one byte in front of it.
    malformed[flag + 1] = 2;
    // The name precedes the illegal depth.
    let mut bad_name = malformed.clone();
    bad_name[5] = b'.';
    let mut unknown = bad_name.clone();
    unknown[0] = 16;
    for (bytes, violation) in [
        (too_deep, violation!(BadQos, "SM2-FRM-003")),
        (not_canonical, violation!(NotCanonical, "SM2-FRM-002")),
        (trailing, violation!(TrailingBytes, "SM2-FRM-001")),
        (malformed, violation!(Malformed, "SM2-FRM-001")),
        (bad_name, violation!(BadName, "SM2-NAM-001")),
        (unknown.clone(), violation!(UnknownFrame, "SM2-FRM-001")),
    ] {
        let decoded = decode_to_manager(&datagram(&bytes, 1));
        assert_eq!(decoded, Err(violation));
        assert_eq!(
            naive::to_manager(&bytes, 1, false),
            Err(violation.kind().name())
        );
    }
    let hello = encode_to_manager(&hello("a"));
    let decoded = decode_to_manager(&datagram(&hello, 1));
    assert_eq!(decoded, Err(violation!(FdCount, "SM2-TRN-010")));
    let cut = Datagram {
        data_truncated: true,
        control_truncated: true,
        ..datagram(&unknown, 1)
    };
    let violation = violation!(FrameTooLong, "SM2-TRN-004");
    assert_eq!(decode_to_manager(&cut), Err(violation));
    assert_eq!(decode_to_node(&cut), Err(violation));
}

//= SM2-TRN-004 test
#[test]
fn the_longest_datagram() {
    for (len, violation) in [
        (DATAGRAM_MAX, violation!(TrailingBytes, "SM2-FRM-001")),
        (DATAGRAM_MAX + 1, violation!(FrameTooLong, "SM2-TRN-004")),
    ] {
        let mut bytes = encode_to_manager(&hello("a"));
        bytes.resize(len, 0);
        assert_eq!(TO_MANAGER.violation(&bytes), Some(violation));
        let mut bytes = vec![8, 0];
        bytes.resize(len, 0);
        assert_eq!(TO_NODE.violation(&bytes), Some(violation));
    }
}
