//! Handshakes, and what stands on the control stream.

use quinn_proto::{ConnectionError, TransportConfig};
use sm2_io::quic::{ALPN, SecretKey};
use sm2_proto::{
    Name,
    gateway::{AskId, Frame, OfferId, PeerFarewell, PeerViolationKind, Verdict},
};

use crate::{
    bench::{Bench, EPOCH, hello, offer, topic},
    client::Client,
    common::until,
    identity::{Shown, tls},
    text,
};

/// What TLS says stands behind this in QUIC (RFC 9001, section 4.8).
const CRYPTO: u64 = 0x100;

//= SM2-GWC-002 test
#[test]
fn a_handshake_needs_a_trusted_raw_key_and_the_protocols_name() {
    let mut bench = Bench::new();
    let (unknown, to) = (SecretKey::generate().unwrap(), bench.left.address());
    let known = &bench.key;
    let table = [
        ("an unknown key", tls(&Shown::Key(&unknown), Some(ALPN)), 49),
        ("no key", tls(&Shown::Nothing, Some(ALPN)), 40),
        (
            "a certificate",
            tls(&Shown::Certificate(known), Some(ALPN)),
            40,
        ),
        ("no protocol", tls(&Shown::Key(known), None), 120),
        (
            "another protocol",
            tls(&Shown::Key(known), Some(b"h3")),
            120,
        ),
    ];
    for (what, tls, alert) in table {
        let mut client = Client::dial(to, tls, TransportConfig::default());
        client.until(what, |it| it.lost.is_some());
        match client.lost.clone() {
            Some(ConnectionError::ConnectionClosed(close)) => {
                assert_eq!(u64::from(close.error_code), CRYPTO + alert, "{what}");
            }
            other => panic!("{what}: {other:?}"),
        }
        assert_eq!(bench.peers(), ["far"], "{what}");
    }
    bench.is_undisturbed();
    bench.stop();
}

//= SM2-GWE-001 test
//= SM2-GWF-001 test
//= SM2-GWF-002 test
//= SM2-GWO-001 test
//= SM2-GWO-002 test
//= SM2-GWO-003 test
//= SM2-GWO-005 test
//= SM2-GWO-006 test
#[test]
fn frames_that_are_not_legal_end_the_connection() {
    let mut bench = Bench::new();
    let me = bench.key.id();
    let subject = topic("m", text());
    let hello_bytes = hello(EPOCH).to_bytes();
    let versions = |min_version, max_version| Frame::Hello {
        min_version,
        max_version,
        epoch: EPOCH,
        name: Name::new("mallory").unwrap(),
    };
    let offered = offer(1, &subject, me).to_bytes();
    let (mut long, mut trailing) = (hello_bytes.clone(), hello_bytes.clone());
    long.extend(65_537_u32.to_le_bytes());
    trailing[0] += 1;
    trailing.push(0);
    let after = |frames: &[Vec<u8>]| {
        hello_bytes
            .iter()
            .copied()
            .chain(frames.concat())
            .collect::<Vec<u8>>()
    };
    let verdict = Verdict::Absent;
    let violation = |it: PeerViolationKind| it.code();
    use PeerViolationKind as V;
    let table = [
        (
            "OFFER before HELLO",
            offered.clone(),
            violation(V::ExpectedHello),
        ),
        (
            "two HELLOs",
            after(std::slice::from_ref(&hello_bytes)),
            violation(V::UnexpectedHello),
        ),
        (
            "no such range",
            versions(2, 1).to_bytes(),
            violation(V::BadVersionRange),
        ),
        (
            "no common version",
            versions(2, 9).to_bytes(),
            PeerFarewell::Version.code(),
        ),
        ("too long", long, violation(V::FrameTooLong)),
        (
            "of no length",
            after(&[vec![0; 4]]),
            violation(V::Malformed),
        ),
        (
            "unknown",
            after(&[vec![1, 0, 0, 0, 99]]),
            violation(V::UnknownFrame),
        ),
        ("bytes too many", trailing, violation(V::TrailingBytes)),
        (
            "offer 0",
            after(&[offer(0, &subject, me).to_bytes()]),
            violation(V::BadOffer),
        ),
        (
            "offered twice",
            after(&[offered.clone(), offered.clone()]),
            violation(V::BadOffer),
        ),
        (
            "another's path",
            after(&[offer(1, &subject, bench.left.id()).to_bytes()]),
            violation(V::BadPath),
        ),
        (
            "WANT of nothing",
            after(&[Frame::Want {
                offer: OfferId(99),
                depth: 1,
            }
            .to_bytes()]),
            violation(V::UnknownOffer),
        ),
        (
            "WANT of no depth",
            after(&[Frame::Want {
                offer: OfferId(1),
                depth: 0,
            }
            .to_bytes()]),
            violation(V::BadQos),
        ),
        (
            "UNOFFERED of nothing",
            after(&[Frame::Unoffered { offer: OfferId(99) }.to_bytes()]),
            violation(V::UnknownOffer),
        ),
        (
            "ANSWER to nothing",
            after(&[Frame::Answer {
                ask: AskId(1),
                verdict,
            }
            .to_bytes()]),
            violation(V::UnexpectedAnswer),
        ),
    ];
    for (what, bytes, code) in table {
        let mut client = bench.dial();
        client.say(&bytes);
        assert_eq!(client.closed(what), u64::from(code.0), "{what}");
    }
    bench.is_undisturbed();
    let mut silent = bench.dial();
    let greeting = PeerFarewell::GreetingTimeout.code();
    assert_eq!(silent.closed("no HELLO"), u64::from(greeting.0));
    let mut ending = bench.greeted();
    ending.finish(ending.control.unwrap());
    let done = PeerFarewell::Done.code();
    assert_eq!(ending.closed("the end"), u64::from(done.0));
    until("only the honest one is left", || bench.peers() == ["far"]);
    bench.is_undisturbed();
    bench.stop();
}

/// Whoever takes a topic takes it again where it is shown again.
//= SM2-GWO-004 test
#[test]
fn what_is_offered_again_is_wanted_again() {
    let bench = Bench::new();
    let hearer = bench.near.node("hearer");
    let _subscriber = hearer.subscriber::<str>("m").unwrap();
    let subject = topic("m", text());
    let mut client = bench.wanted(&subject);
    for number in 2..20 {
        client.frame(&Frame::Unoffer {
            offer: OfferId(number - 1),
        });
        client.frame(&offer(number, &subject, bench.key.id()));
        client.until("WANT again", |it| {
            let mut frames = it.frames.iter();
            frames.any(|it| matches!(it, Frame::Want { offer, .. } if *offer == OfferId(number)))
        });
    }
    bench.stop();
}
