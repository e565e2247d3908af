//! Limits on the memory that a peer can make a gateway use. `offers` has what waits for a peer in virtual time, and
//! `streams` has what arrives from it.

use quinn_proto::{Dir, TransportConfig};
use sm2_gateway::keys;
use sm2_proto::{
    Name,
    gateway::{AskId, Frame, OfferId, Subject, SubjectKind},
    limits::{MESSAGES_IN_FLIGHT_MAX, OFFERS_MAX, QUESTIONS_MAX},
};

use super::{
    bench::{EPOCH, greeted, offer},
    client::Client,
    identity::honest_tls,
    message, text,
};
use crate::common::{ALL, Domain, Process};

const MESSAGE_BYTES: usize = 8 << 20;
const MEMORY_BYTES: usize = 32 << 20;
/// The bytes that QUIC may buffer for the peer before they are read, and all other memory.
const BESIDE_BYTES: usize = 64 << 20;

fn topic(number: usize) -> Subject {
    // A name of the greatest length.
    let name = format!("{}{number:04}", "x".repeat(251));
    Subject::Topic {
        name: Name::new(&name).unwrap(),
        data: text(),
        reliable: false,
        latched: 1_024,
    }
}

/// Sends the greatest number of offers with the longest names, the greatest number of calls, and
/// the greatest number of payloads. None of them ever ends.
#[test]
fn what_a_peer_sends_takes_no_more_memory_than_it_may() {
    let [near, mallory] = ["near", "mallory"].map(Domain::new);
    let limits =
        format!("[limits]\nmessage_bytes = {MESSAGE_BYTES}\nmemory_bytes = {MEMORY_BYTES}\n");
    near.config(&[(&mallory, None)], &format!("{ALL}{limits}"));
    let file = near.path("gateway.toml");
    let hearer = near.node("hearer");
    let _subscriber = hearer.subscriber::<str>(topic(1).name().as_str()).unwrap();
    let (gateway, address) = Process::listening(&file);
    let key = keys::load(&mallory.path("key")).unwrap();
    let dial = || {
        let transport = TransportConfig::default();
        Client::dial(address, honest_tls(&key), transport).connected()
    };
    let mut client = greeted(dial, EPOCH);
    let before = gateway.private_bytes();
    let mut most = before;
    let offers = (1..=OFFERS_MAX).map(|number| {
        let frame = offer(number as u64, &topic(number), key.id());
        frame.to_bytes()
    });
    client.say(&offers.collect::<Vec<_>>().concat());
    let wanted = |it: &Frame| {
        matches!(
            it,
            Frame::Want {
                offer: OfferId(1),
                ..
            }
        )
    };
    client.until("WANT", |it| it.frames.iter().any(wanted));
    let questions = (1..=QUESTIONS_MAX as u64).map(|ask| {
        let (kind, name) = (SubjectKind::Topic, topic(2).name().clone());
        Frame::Ask {
            ask: AskId(ask),
            kind,
            name,
        }
        .to_bytes()
    });
    client.say(&questions.collect::<Vec<_>>().concat());
    let payload = vec![b'x'; 2 << 20];
    let header = message(1, MESSAGE_BYTES as u64);
    for _ in 0..MESSAGES_IN_FLIGHT_MAX {
        assert!(client.lost.is_none(), "{:?}", client.lost);
        let stream = client.open(Dir::Uni);
        client.write_all(stream, &header.to_bytes());
        client.write_all(stream, &payload);
        most = most.max(gateway.private_bytes());
    }
    client.until("much is kept", |_| {
        most = most.max(gateway.private_bytes());
        most > before + MEMORY_BYTES / 2
    });
    client.round_trip();
    most = most.max(gateway.private_bytes());
    println!(
        "a hostile peer: {:.1} MB before, {:.1} MB at most; {:.1} MB of payloads were allowed",
        before as f64 / 1e6,
        most as f64 / 1e6,
        MEMORY_BYTES as f64 / 1e6
    );
    assert!(client.lost.is_none(), "{:?}", client.lost);
    assert!(most < before + MEMORY_BYTES + BESIDE_BYTES);
}
