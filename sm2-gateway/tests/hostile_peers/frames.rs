//! Illegal handshakes and control frames.

use quinn_proto::{ConnectionError, TransportConfig};
use sm2_io::quic::{ALPN, SecretKey};
use sm2_proto::{
    Code, Name,
    gateway::{AskId, Frame, GatewayId, OfferId, PeerFarewell, PeerViolationKind, Verdict},
};

use super::{
    bench::{Bench, EPOCH, hello, offer, topic},
    client::Client,
    identity::{Shown, tls},
    text,
};
use sm2_test_support::until;

/// The QUIC error code of TLS alert 0 (RFC 9001, section 4.8).
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

/// A description, the bytes on the control stream, and the code that closes the connection.
type Case = (&'static str, Vec<u8>, Code);

/// Illegal greetings, or frames before the greeting.
fn illegal_greetings(me: GatewayId) -> Vec<Case> {
    use PeerViolationKind as V;
    let versions = |min_version, max_version| {
        let hello = Frame::Hello {
            min_version,
            max_version,
            epoch: EPOCH,
            name: Name::new("mallory").unwrap(),
        };
        hello.to_bytes()
    };
    let mut trailing = hello(EPOCH).to_bytes();
    trailing[0] += 1;
    trailing.push(0);
    let offered = offer(1, &topic("m", text()), me).to_bytes();
    let version = PeerFarewell::Version.code();
    vec![
        ("OFFER before HELLO", offered, V::ExpectedHello.code()),
        ("min above max", versions(2, 1), V::BadVersionRange.code()),
        ("no common version", versions(2, 9), version),
        ("trailing bytes", trailing, V::TrailingBytes.code()),
    ]
}

/// Frames that are illegal after the greeting.
fn illegal_frames(me: GatewayId, other: GatewayId) -> Vec<Case> {
    use PeerViolationKind as V;
    let subject = topic("m", text());
    let offered = |number, origin| offer(number, &subject, origin).to_bytes();
    let want = |number, depth| {
        let offer = OfferId(number);
        Frame::Want { offer, depth }.to_bytes()
    };
    let unoffered = Frame::Unoffered { offer: OfferId(99) }.to_bytes();
    let answer = Frame::Answer {
        ask: AskId(1),
        verdict: Verdict::Absent,
    };
    let long = 65_537_u32.to_le_bytes().to_vec();
    let twice = [offered(1, me), offered(1, me)].concat();
    let table = [
        ("two HELLOs", hello(EPOCH).to_bytes(), V::UnexpectedHello),
        ("a frame that is too long", long, V::FrameTooLong),
        ("a frame without a body", vec![0; 4], V::Malformed),
        ("an unknown frame", vec![1, 0, 0, 0, 99], V::UnknownFrame),
        ("offer 0", offered(0, me), V::BadOffer),
        ("the same offer twice", twice, V::BadOffer),
        ("the path of another", offered(1, other), V::BadPath),
        ("WANT of no offer", want(99, 1), V::UnknownOffer),
        ("WANT without depth", want(1, 0), V::BadQos),
        ("UNOFFERED of no offer", unoffered, V::UnknownOffer),
        ("ANSWER to no ASK", answer.to_bytes(), V::UnexpectedAnswer),
    ];
    let greeted = |bytes: Vec<u8>| [hello(EPOCH).to_bytes(), bytes].concat();
    let cases = table.map(|(what, bytes, violation)| (what, greeted(bytes), violation.code()));
    cases.into()
}

//= SM2-GWE-001 test
//= SM2-GWF-001 test
//= SM2-GWF-002 test
//= SM2-GWO-001 test
//= SM2-GWO-002 test
//= SM2-GWO-003 test
//= SM2-GWO-006 test
//= SM2-GWO-007 test
#[test]
fn frames_that_are_not_legal_end_the_connection() {
    let mut bench = Bench::new();
    let me = bench.key.id();
    let frames = illegal_frames(me, bench.left.id());
    for (what, bytes, code) in illegal_greetings(me).into_iter().chain(frames) {
        let closed = bench.closed(what, |it| it.say(&bytes));
        assert_eq!(closed, u64::from(code.0), "{what}");
    }
    bench.is_undisturbed();
    // This takes 2 s. `silence` has it in virtual time.
    if cfg!(feature = "slow") {
        let mut silent = bench.dial();
        let greeting = PeerFarewell::GreetingTimeout.code();
        assert_eq!(silent.closed("no HELLO"), u64::from(greeting.0));
    }
    let mut ending = bench.greeted();
    ending.finish(ending.control.unwrap());
    let done = PeerFarewell::Done.code();
    assert_eq!(ending.closed("the end"), u64::from(done.0));
    until("only the honest one is left", || bench.peers() == ["far"]);
    bench.is_undisturbed();
    bench.stop();
}

/// A gateway wants a topic again after the topic is offered again.
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
