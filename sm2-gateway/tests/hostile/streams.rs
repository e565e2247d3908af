//! What comes by streams of its own.

use std::time::Duration;

use quinn_proto::Dir;
use sm2_io::quic::CALLS_MAX;
use sm2_proto::gateway::{
    Carried, Frame, Header, OfferId, Outcome, PeerFarewell, PeerViolationKind, Subject,
};

use crate::{
    bench::{Bench, MEMORY_BYTES, MESSAGE_BYTES, topic},
    client::Client,
    message, text,
};

//= SM2-GWM-001 test
//= SM2-GWM-002 test
//= SM2-GWM-003 test
//= SM2-GWM-006 test
//= SM2-GWS-001 test
#[test]
fn streams_that_are_not_legal_end_the_connection() {
    let mut bench = Bench::new();
    let hearer = bench.near.node("hearer");
    let _subscriber = hearer.subscriber::<str>("m").unwrap();
    let left_ns = 0;
    let request = |offer| Header {
        carried: Carried::Request { left_ns },
        offer,
        len: 0,
    };
    let (mut other, mut vast) = (message(1, 0).to_bytes(), message(1, 0).to_bytes());
    other[0] = 9;
    vast[39] = 1;
    let whole = message(1, 3).to_bytes();
    let more = [&whole[..], b"four"].concat();
    let fewer = [&whole[..], b"to"].concat();
    use PeerViolationKind as V;
    let table = [
        ("no such type", Dir::Uni, other.to_vec(), V::Malformed),
        ("vast", Dir::Uni, vast.to_vec(), V::BadLength),
        (
            "a header's half",
            Dir::Uni,
            whole[..20].to_vec(),
            V::Malformed,
        ),
        ("no header", Dir::Uni, Vec::new(), V::Malformed),
        ("more bytes", Dir::Uni, more, V::Malformed),
        ("fewer bytes", Dir::Uni, fewer, V::Malformed),
        (
            "not offered",
            Dir::Uni,
            message(2, 0).to_bytes().to_vec(),
            V::NotWanted,
        ),
        (
            "a call on one way",
            Dir::Uni,
            request(OfferId(1)).to_bytes().to_vec(),
            V::Malformed,
        ),
        ("a message on two", Dir::Bi, whole.to_vec(), V::Malformed),
        (
            "a call of nothing",
            Dir::Bi,
            request(OfferId(99)).to_bytes().to_vec(),
            V::UnknownOffer,
        ),
    ];
    for (what, dir, bytes, violation) in table {
        let mut client = bench.wanted(&topic("m", text()));
        let stream = client.open(dir);
        client.write(stream, &bytes);
        client.finish(stream);
        let code = violation.code().0;
        assert_eq!(client.closed(what), u64::from(code), "{what}");
    }
    // As soon as they are there: the end of the stream is not waited for.
    let mut client = bench.wanted(&topic("m", text()));
    let stream = client.open(Dir::Uni);
    client.write(stream, &[&whole[..], b"four"].concat());
    let code = V::Malformed.code().0;
    assert_eq!(client.closed("more bytes and no end"), u64::from(code));
    let mut client = bench.greeted();
    client.send(Dir::Uni, &message(1, 0), b"");
    let code = V::NotWanted.code().0;
    assert_eq!(client.closed("never offered"), u64::from(code));
    let mut client = bench.dial();
    client.send(Dir::Uni, &message(1, 0), b"");
    let code = V::ExpectedHello.code().0;
    // The control stream is the first that is opened.
    client.say(&[]);
    assert_eq!(client.closed("before HELLO"), u64::from(code));
    let mut client = bench.greeted();
    client.datagram(&[7; 50]);
    let code = V::Malformed.code().0;
    assert_eq!(client.closed("a datagram"), u64::from(code));
    bench.is_undisturbed();
    bench.stop();
}

/// What is too much is refused, and the connection stays.
//= SM2-GWM-006 test
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
    // As many unfinished ones as may be: those that do not fit in all are refused too.
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
    bench.is_undisturbed();
    for stream in begun {
        client.give_up_sending(stream);
    }
    client.wait();
    let heard = (1..40).any(|sequence| {
        let age_ns = 0;
        let carried = Carried::Message { sequence, age_ns };
        let header = Header {
            carried,
            ..message(1, text.len() as u64)
        };
        client.send(Dir::Uni, &header, text);
        client.wait();
        let sample = subscriber.recv_timeout(Duration::from_millis(100)).unwrap();
        sample.is_some_and(|it| *it == *"short")
    });
    assert!(heard, "the connection carries messages");
    assert!(client.lost.is_none(), "{:?}", client.lost);
    bench.is_undisturbed();
    bench.stop();
}

/// A peer may drop its calls as often as it likes.
//= SM2-GWS-003 test
//= SM2-GWS-004 test
#[test]
fn calls_that_are_dropped_leave_room_for_others() {
    let mut bench = Bench::new();
    let serving = bench.near.node("serving");
    let server = serving.server::<str, str>("echo").unwrap();
    let mut client = bench.greeted();
    let is_echo = |it: &Frame| matches!(it, Frame::Offer { subject: Subject::Service { name, .. }, .. } if name.as_str() == "echo");
    client.until("OFFER", |it| it.frames.iter().any(is_echo));
    let offers = client.frames.iter().find_map(|it| match it {
        Frame::Offer { offer, .. } if is_echo(it) => Some(*offer),
        _ => None,
    });
    let offer = offers.unwrap();
    client.frame(&Frame::Want { offer, depth: 1 });
    client.wait();
    let left_ns = 0;
    let request = |len| Header {
        carried: Carried::Request { left_ns },
        offer,
        len,
    };
    for round in 0..CALLS_MAX / 64 + 1 {
        let dropped: Vec<_> = (0..64)
            .map(|number| {
                let stream = client.open(Dir::Bi);
                // Whole, half of it, and too long.
                match number % 3 {
                    0 => {
                        client.write(stream, &request(2).to_bytes());
                        client.write(stream, b"ab");
                        client.finish(stream);
                    }
                    1 => client.write(stream, &request(2).to_bytes()[..30]),
                    _ => client.write(stream, &request(MESSAGE_BYTES as u64 + 1).to_bytes()),
                }
                stream
            })
            .collect();
        client.wait();
        for stream in dropped {
            client.give_up(stream);
        }
        client.wait();
        assert!(client.lost.is_none(), "{round}: {:?}", client.lost);
    }
    let server = std::thread::spawn(move || {
        while let Some(request) = server.recv_timeout(Duration::from_secs(2)).unwrap() {
            let text = request.to_owned();
            let _ = request.reply(&text);
        }
    });
    let call = client.send(Dir::Bi, &request(4), b"last");
    let replied = |it: &mut Client| it.came.get(&call).is_some_and(|it| it.1.is_some());
    client.until("the reply", replied);
    let (bytes, end) = &client.came[&call];
    assert_eq!(*end, Some(Ok(())));
    let head = Header::from_bytes(bytes.first_chunk().unwrap()).unwrap();
    let status = Outcome::Ok;
    assert_eq!(head.carried, Carried::Reply { status });
    assert_eq!(&bytes[40..], b"last");
    server.join().unwrap();
    bench.is_undisturbed();
    bench.stop();
}
