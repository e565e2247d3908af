//! Peers that break the rules, by mistake or on purpose. The gateway closes the connection or
//! resets the stream with the right code, and no other peer is affected.

// Shows GW-AUTH, GW-LIMIT (test, full), bound: raw QUIC peers, over this machine.

mod bench;
mod client;
mod frames;
pub(crate) mod identity;
#[cfg(all(feature = "program", feature = "slow"))]
mod memory;
#[cfg(feature = "slow")]
mod stalled;
mod streams;

use std::net::UdpSocket;

use bench::{Bench, EPOCH, topic};
use quinn_proto::{Dir, TransportConfig, VarInt};
use sm2_node::Message;
use sm2_proto::gateway::{Beacon, Frame, Header, HeaderKind, OfferId};
use sm2_test_support::{SOON, until};

fn text() -> sm2_proto::TypeId {
    <str as Message>::type_id()
}

fn message(offer: u64, len: u64) -> Header {
    let kind = HeaderKind::Message {
        sequence: 1,
        age_ns: 0,
    };
    Header {
        kind,
        offer: OfferId(offer),
        len,
    }
}

/// One peer opens streams and sends nothing on them; another reads nothing.
//= SM2-GWM-004 test
#[test]
fn a_peer_that_does_nothing_harms_nobody() {
    let mut bench = Bench::new();
    let hearer = bench.near.node("hearer");
    let _subscriber = hearer.subscriber::<str>("m").unwrap();
    let mut idle = bench.wanted(&topic("m", text()));
    for _ in 0..64 {
        let stream = idle.open(Dir::Uni);
        idle.write(stream, &[1]);
    }
    idle.round_trip();
    bench.is_undisturbed_beside(&mut idle);
    drop(idle);
    // This takes 5 s. Otherwise the connection ends when the next one greets with a greater epoch.
    if cfg!(feature = "slow") {
        until("the silent one is lost", || bench.peers() == ["far"]);
    }
    let transport = || {
        let mut transport = TransportConfig::default();
        transport
            .stream_receive_window(VarInt::from_u32(100))
            .receive_window(VarInt::from_u32(1_000));
        transport
    };
    let mut deaf = bench.greeted_with(transport, EPOCH + 1);
    let talker = bench.near.node("talker2");
    let publisher = talker.publisher::<str>("flood").unwrap();
    let is_flood = |it: &Frame| matches!(it, Frame::Offer { subject, .. } if subject.name().as_str() == "flood");
    deaf.until("OFFER", |it| it.frames.iter().any(is_flood));
    for frame in deaf.frames.clone() {
        if let Frame::Offer { offer, .. } = frame {
            deaf.frame(&Frame::Want {
                offer,
                depth: 1_024,
            });
        }
    }
    deaf.round_trip();
    deaf.is_deaf = true;
    publisher.wait_for_subscribers_timeout(1, SOON).unwrap();
    let long = "x".repeat(50_000);
    for _ in 0..200 {
        publisher.publish(&long).unwrap();
        deaf.turn();
    }
    bench.is_undisturbed_beside(&mut deaf);
    // Until the gateway has as much for the peer as it may keep.
    deaf.until("superseded", |_| {
        publisher.publish(&long).unwrap();
        bench.superseded("mallory", "flood") > 0
    });
    bench.is_undisturbed_beside(&mut deaf);
    assert!(deaf.lost.is_none(), "{:?}", deaf.lost);
    bench.stop();
}

/// Random datagrams arrive at the gateway's port.
//= SM2-GWD-002 test
#[test]
fn datagrams_of_anybody_change_nothing() {
    let mut bench = Bench::new();
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let beacon = Beacon {
        port: 9,
        gateway: bench.far_id(),
        epoch: u64::MAX,
    };
    let mut number = 1_u32;
    for round in 0..5_000_usize {
        let bytes: Vec<u8> = (0..round % 1_400)
            .map(|_| {
                number = number.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                (number >> 24) as u8
            })
            .collect();
        let mut long = bytes.clone();
        // A valid start of QUIC's first datagram.
        long.splice(..0, [0xc0, 0, 0, 0, 1, 8]);
        long.resize(1_200, 0);
        for bytes in [&bytes[..], &long, &beacon.to_bytes()] {
            let _ = socket.send_to(bytes, bench.left.address());
        }
        if round % 1_000 == 0 {
            bench.is_undisturbed();
        }
    }
    bench.is_undisturbed();
    assert_eq!(bench.peers(), ["far"]);
    bench.stop();
}
