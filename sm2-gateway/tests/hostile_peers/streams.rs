//! Streams of messages and calls that are not legal, too long, or abandoned.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use quinn_proto::{Dir, TransportConfig, VarInt};
use sm2_io::quic::CALLS_MAX;
use sm2_proto::gateway::{
    Frame, Header, HeaderKind, OfferId, Outcome, PeerFarewell, PeerViolationKind, Subject,
};

use super::{
    bench::{Bench, EPOCH, MEMORY_BYTES, MESSAGE_BYTES, topic},
    client::Client,
    message, text,
};

/// Streams that are not legal: what each carries, and the violation.
fn illegal_streams() -> [(&'static str, Dir, Vec<u8>, PeerViolationKind); 10] {
    use PeerViolationKind as V;
    let request = |offer| {
        let header = Header {
            kind: HeaderKind::Request { left_ns: 0 },
            offer: OfferId(offer),
            len: 0,
        };
        header.to_bytes().to_vec()
    };
    let message = |offer, len| message(offer, len).to_bytes().to_vec();
    let (mut unknown, mut vast) = (message(1, 0), message(1, 0));
    unknown[0] = 9;
    vast[39] = 1;
    let half = message(1, 3)[..20].to_vec();
    let more = [&message(1, 3), &b"four"[..]].concat();
    let fewer = [&message(1, 3), &b"to"[..]].concat();
    let (uni, bi) = (Dir::Uni, Dir::Bi);
    [
        ("an unknown type", uni, unknown, V::Malformed),
        ("a vast length", uni, vast, V::BadLength),
        ("half a header", uni, half, V::Malformed),
        ("no header", uni, Vec::new(), V::Malformed),
        ("more bytes", uni, more, V::Malformed),
        ("fewer bytes", uni, fewer, V::Malformed),
        ("no such offer", uni, message(2, 0), V::NotWanted),
        ("a call on one way", uni, request(1), V::Malformed),
        ("a message on two ways", bi, message(1, 3), V::Malformed),
        ("a call of no offer", bi, request(99), V::UnknownOffer),
    ]
}

//= SM2-GWM-001 test
//= SM2-GWM-002 test
//= SM2-GWM-003 test
//= SM2-GWM-011 test
//= SM2-GWS-001 test
#[test]
fn streams_that_are_not_legal_end_the_connection() {
    let mut bench = Bench::new();
    let hearer = bench.near.node("hearer");
    let _subscriber = hearer.subscriber::<str>("m").unwrap();
    for (what, dir, bytes, violation) in illegal_streams() {
        let mut client = bench.wanted(&topic("m", text()));
        let stream = client.open(dir);
        client.write(stream, &bytes);
        client.finish(stream);
        let code = violation.code().0;
        assert_eq!(client.closed(what), u64::from(code), "{what}");
    }
    use PeerViolationKind as V;
    // Too many bytes are a violation at once, not only at the end of the stream.
    let mut client = bench.wanted(&topic("m", text()));
    let stream = client.open(Dir::Uni);
    client.write(stream, &[&message(1, 3).to_bytes()[..], b"four"].concat());
    let code = V::Malformed.code().0;
    assert_eq!(client.closed("more bytes and no end"), u64::from(code));
    let mut client = bench.greeted();
    client.send(Dir::Uni, &message(1, 0), b"");
    let code = V::NotWanted.code().0;
    assert_eq!(client.closed("never offered"), u64::from(code));
    let closed = bench.closed("before HELLO", |it| {
        it.send(Dir::Uni, &message(1, 0), b"");
        // Opens the control stream, which is the first bidirectional one.
        it.say(&[]);
    });
    assert_eq!(closed, u64::from(V::ExpectedHello.code().0));
    let mut client = bench.greeted();
    client.datagram(&[7; 50]);
    let code = V::Malformed.code().0;
    assert_eq!(client.closed("a datagram"), u64::from(code));
    bench.is_undisturbed();
    bench.stop();
}

/// Payloads beyond the limits are refused, and the connection stays.
//= SM2-GWM-011 test
#[test]
fn payloads_that_are_too_long_are_refused() {
    let mut bench = Bench::new();
    let hearer = bench.near.node("hearer");
    let subscriber = hearer.subscriber::<str>("m").unwrap();
    let mut client = bench.wanted(&topic("m", text()));
    let text = b"short";
    let long = vec![b'x'; MESSAGE_BYTES + 1];
    let refused = client.send(Dir::Uni, &message(1, long.len() as u64), &long);
    client.until("refused", |it| it.stopped.contains_key(&refused));
    let code = PeerFarewell::Resources.code().0;
    assert_eq!(client.stopped[&refused], u64::from(code));
    // Unfinished payloads are refused once their sum exceeds the limit.
    let header = message(1, MESSAGE_BYTES as u64);
    let begun: Vec<_> = (0..40)
        .map(|_| {
            let stream = client.open(Dir::Uni);
            client.write(stream, &header.to_bytes());
            client.write(stream, &long[..60_000]);
            stream
        })
        .collect();
    client.until("some are refused", |it| {
        let refused = begun.iter().filter(|id| it.stopped.contains_key(id));
        refused.count() >= 40 - MEMORY_BYTES / 60_000
    });
    bench.is_undisturbed_beside(&mut client);
    for stream in begun {
        client.give_up_sending(stream);
    }
    client.round_trip();
    // A message that the gateway refuses, because it does not know yet that others were given up, is sent again.
    let mut sequence = 0;
    let mut sent = None;
    client.until("the connection carries messages", |it| {
        if sent.is_none_or(|id| it.stopped.contains_key(&id)) {
            sequence += 1;
            let age_ns = 0;
            let kind = HeaderKind::Message { sequence, age_ns };
            let header = Header {
                kind,
                ..message(1, text.len() as u64)
            };
            sent = Some(it.send(Dir::Uni, &header, text));
        }
        let sample = subscriber.try_recv().unwrap();
        sample.is_some_and(|it| *it == *"short")
    });
    assert!(client.lost.is_none(), "{:?}", client.lost);
    bench.is_undisturbed_beside(&mut client);
    bench.stop();
}

/// A peer that reads nothing keeps the messages that wait for it, but no samples that others need.
#[test]
fn a_peer_that_reads_nothing_does_not_starve_the_others() {
    let mut bench = Bench::new();
    let transport = || {
        let mut transport = TransportConfig::default();
        transport.stream_receive_window(VarInt::from_u32(1_000));
        transport
    };
    let mut client = bench.greeted_with(transport, EPOCH);
    let chatter = |it: &Frame| match it {
        Frame::Offer { offer, subject, .. } if subject.name().as_str() == "chatter" => Some(*offer),
        _ => None,
    };
    client.until("OFFER", |it| {
        it.frames.iter().any(|it| chatter(it).is_some())
    });
    let offer = client.frames.iter().find_map(chatter).unwrap();
    client.frame(&Frame::Want { offer, depth: 64 });
    client.round_trip();
    client.is_deaf = true;
    for _ in 0..64 {
        bench.carries(20_000, &mut client);
    }
    assert!(client.lost.is_none(), "{:?}", client.lost);
    let mut peers = bench.peers();
    peers.sort_unstable();
    assert_eq!(peers, ["far", "mallory"]);
    bench.stop();
}

/// Opens 64 calls in different ways, and abandons them.
fn drop_calls(client: &mut Client, request: impl Fn(u64) -> Header) {
    let dropped: Vec<_> = (0..64)
        .map(|number| {
            let stream = client.open(Dir::Bi);
            match number % 3 {
                // A complete request.
                0 => {
                    client.write(stream, &request(2).to_bytes());
                    client.write(stream, b"ab");
                    client.finish(stream);
                }
                // A part of a header.
                1 => client.write(stream, &request(2).to_bytes()[..30]),
                // A request that is too long.
                _ => client.write(stream, &request(MESSAGE_BYTES as u64 + 1).to_bytes()),
            }
            stream
        })
        .collect();
    client.round_trip();
    for stream in dropped {
        client.give_up(stream);
    }
    client.round_trip();
}

/// A peer may abandon any number of calls.
//= SM2-GWS-003 test
//= SM2-GWS-004 test
#[test]
fn calls_that_are_dropped_leave_room_for_others() {
    let mut bench = Bench::new();
    let serving = bench.near.node("serving");
    let server = serving.server::<str, str>("echo").unwrap();
    let mut client = bench.greeted();
    let is_echo = |it: &Frame| match it {
        Frame::Offer {
            subject: Subject::Service { name, .. },
            ..
        } => name.as_str() == "echo",
        _ => false,
    };
    client.until("OFFER", |it| it.frames.iter().any(is_echo));
    let offers = client.frames.iter().find_map(|it| match it {
        Frame::Offer { offer, .. } if is_echo(it) => Some(*offer),
        _ => None,
    });
    let offer = offers.unwrap();
    client.frame(&Frame::Want { offer, depth: 1 });
    client.round_trip();
    let left_ns = 0;
    let request = |len| Header {
        kind: HeaderKind::Request { left_ns },
        offer,
        len,
    };
    for round in 0..CALLS_MAX / 64 + 1 {
        drop_calls(&mut client, request);
        assert!(client.lost.is_none(), "{round}: {:?}", client.lost);
    }
    let is_over = Arc::new(AtomicBool::new(false));
    let until_over = Arc::clone(&is_over);
    let server = std::thread::spawn(move || {
        while !until_over.load(Ordering::Relaxed) {
            let request = server.recv_timeout(Duration::from_millis(10)).unwrap();
            if let Some(request) = request {
                let text = request.to_owned();
                let _ = request.reply(&text);
            }
        }
    });
    let call = client.send(Dir::Bi, &request(4), b"last");
    let replied = |it: &mut Client| it.came.get(&call).is_some_and(|it| it.1.is_some());
    client.until("the reply", replied);
    let (bytes, end) = &client.came[&call];
    assert_eq!(*end, Some(Ok(())));
    let head = Header::from_bytes(bytes.first_chunk().unwrap()).unwrap();
    let status = Outcome::Ok;
    assert_eq!(head.kind, HeaderKind::Reply { status });
    assert_eq!(&bytes[40..], b"last");
    is_over.store(true, Ordering::Relaxed);
    server.join().unwrap();
    bench.is_undisturbed();
    bench.stop();
}
