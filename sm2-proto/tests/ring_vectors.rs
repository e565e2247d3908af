//! Replays `tests/vectors/ring.json`, the golden vectors of the words of a ring.
//!
//! `tests/vectors/README.md` describes the fields. The other end of each link exists only to open
//! the link: `image` and `before` replace all words that it would have written.

// Shows RNG-INDEX, RNG-FIFO, RNG-HOSTILE (vector).

use std::collections::{BTreeMap, BTreeSet};

use crate::ring_support::{RECEIVER, Rig, SENDER, ring_config, segment};
use serde_json::{Value, json};
use sm2_proto::{
    Instant, Period, Violation,
    limits::SLOT_HEAD,
    link::{
        CellMessage, Config, End, Error, Fate, Input, LentRing, Misuse, NoDelivery, Payload, Role,
        Status, Wake,
    },
};

/// The outcome of an action.
#[derive(Debug, PartialEq)]
enum Outcome {
    Result(Value),
    Violation(Violation),
}

#[test]
fn every_ring_vector() {
    for vector in vectors() {
        let name = &vector["name"];
        assert_eq!(vector["to"], "node", "{name}");
        let number = |key: &str| u16::try_from(vector[key].as_u64().unwrap()).unwrap();
        let reliable = vector["reliable"].as_bool().unwrap();
        let lifespan = vector.get("lifespan").and_then(Value::as_u64);
        let config = |role| Config {
            lifespan: Period(lifespan.unwrap_or(0)),
            lease: Period::NONE,
            ..ring_config(role, reliable, number("depth"), number("max_borrowed"))
        };
        let mut rig = Rig::with([Role::Sender, Role::Receiver].map(config)).opened();
        let end = match vector["role"].as_str().unwrap() {
            "sender" => SENDER,
            "receiver" => RECEIVER,
            other => panic!("{name}: {other}"),
        };
        for step in vector["prepare"].as_array().unwrap() {
            let outcome = act(&mut rig, end, step);
            assert!(matches!(outcome, Outcome::Result(_)), "{name}: {outcome:?}");
        }
        rig.settled.clear();
        rig.words.set_image(&image(&vector["before"]));
        match act(&mut rig, end, &vector["action"]) {
            Outcome::Result(result) => assert_eq!(Some(&result), vector.get("result"), "{name}"),
            Outcome::Violation(violation) => {
                let code = violation.kind().name();
                assert_eq!(vector.get("violation"), Some(&json!(code)), "{name}");
                assert_eq!(violation.clause().to_string(), vector["clause"], "{name}");
            }
        }
        assert_eq!(rig.words.image(), image(&vector["after"]), "{name}");
    }
}

#[test]
fn every_rule_of_words_has_a_ring_vector() {
    let vectors = vectors();
    let clauses: BTreeSet<_> = vectors.iter().map(|it| &it["clause"]).map(text).collect();
    let expected = ["003", "004", "005", "006", "007", "008", "012", "013"];
    assert_eq!(clauses, expected.map(|it| format!("SM2-RNG-{it}")).into());
    let violations = vectors.iter().filter_map(|it| it.get("violation"));
    let violations: BTreeSet<_> = violations.map(text).collect();
    let expected = [
        "bad-id",
        "bad-length",
        "bad-slot",
        "bad-word",
        "reserved-not-zero",
        "slot-busy",
        "unknown-segment",
        "window-exceeded",
    ];
    assert_eq!(violations, expected.map(str::to_owned).into());
}

/// Performs one action of a vector.
fn act(rig: &mut Rig, end: usize, action: &Value) -> Outcome {
    let (verb, of) = action.as_object().unwrap().iter().next().unwrap();
    match verb.as_str() {
        "image" => {
            rig.words.set_image(&image(of));
            Outcome::Result(Value::Null)
        }
        "send" => {
            let id = of["id"].as_u64().unwrap();
            let sent = match of.get("cell") {
                Some(payload) => rig.send_bytes(&CellMessage {
                    id,
                    time: Instant(of["time"].as_u64().unwrap()),
                    status: Status::Ok,
                    bytes: &payload_of(payload),
                }),
                None => rig.send(id, u32::try_from(of["slot"].as_u64().unwrap()).unwrap()),
            };
            sent_or_settled(rig, sent)
        }
        "harvest" => {
            let harvested = rig.harvest();
            sent_or_settled(rig, harvested)
        }
        "take" => take(rig, of),
        "release" => match rig.release_all(sequences(of)) {
            Ok(wake) => Outcome::Result(json!({ "doorbell": wake.is_needed() })),
            Err(error) => refused(&error),
        },
        "park" => {
            rig.ends[end].park(&rig.words);
            Outcome::Result(json!({}))
        }
        other => panic!("{other}"),
    }
}

fn sequences(of: &Value) -> impl Iterator<Item = u64> {
    let sequences = of["sequences"].as_array().unwrap().iter();
    sequences.map(|it| it.as_u64().unwrap())
}

fn sent_or_settled(rig: &mut Rig, result: Result<Wake, Error>) -> Outcome {
    let wake = match result {
        Ok(wake) => wake,
        Err(error) => return refused(&error),
    };
    let name = |fate| match fate {
        Fate::Delivered => "delivered",
        Fate::Discarded => "discarded",
        Fate::Expired => "expired",
        other => panic!("{other:?}"),
    };
    // The rig's key of a message is ten times its id.
    let settled = rig.settled();
    let settled = settled
        .iter()
        .map(|(key, fate)| json!({ "id": key / 10, "fate": name(*fate) }));
    let settled: Vec<_> = settled.collect();
    Outcome::Result(json!({ "settled": settled, "doorbell": wake.is_needed() }))
}

fn take(rig: &mut Rig, of: &Value) -> Outcome {
    let head = of.get("head").map(bytes::<SLOT_HEAD>);
    let copy = |_| Some(head.expect("no head is read"));
    let taken = rig.ends[RECEIVER].take(&LentRing::new(&rig.words, copy));
    match taken {
        Ok(None) => Outcome::Result(Value::Null),
        Ok(Some(it)) => {
            let mut result = json!({
                "sequence": it.sequence, "id": it.id,
                "len": it.len, "time": it.time.0, "lost": it.lost,
            });
            match it.payload {
                Payload::Pooled { offset, .. } => {
                    result["slot"] = json!(offset / segment(0).stride);
                }
                Payload::Cell(bytes) => result["cell"] = json!(hex(&bytes)),
                other => panic!("{other:?}"),
            }
            Outcome::Result(result)
        }
        Err(NoDelivery::TooManyBorrowed(_)) => {
            Outcome::Result(json!({ "refused": "too-many-borrowed" }))
        }
        Err(NoDelivery::UnknownSegment) => match rig.input(RECEIVER, Input::SegmentMissing) {
            Err(error) => refused(&error),
            Ok(()) => panic!("no datagram attached the segment"),
        },
        Err(NoDelivery::Ended(end)) => refused(&Error::Ended(end)),
        Err(NoDelivery::Misuse(misuse)) => panic!("{misuse}"),
    }
}

fn refused(error: &Error) -> Outcome {
    match error {
        Error::Misuse(misuse) => {
            let why = match misuse {
                Misuse::NoRoom => "no-room",
                Misuse::TooLong => "too-long",
                Misuse::NotPooled => "no-cell",
                Misuse::NotBorrowed => "not-borrowed",
                other => panic!("{other}"),
            };
            Outcome::Result(json!({ "refused": why }))
        }
        Error::Ended(End::Violation(violation)) => Outcome::Violation(*violation),
        other => panic!("{other}"),
    }
}

/// The words that are not 0, by their offset in the file.
fn image(value: &Value) -> BTreeMap<u64, u64> {
    let words = value.as_object().unwrap().iter();
    words
        .map(|(offset, word)| {
            let bits = u64::from_le_bytes(bytes(word));
            (offset.parse().unwrap(), bits)
        })
        .collect()
}

fn bytes<const N: usize>(hex: &Value) -> [u8; N] {
    payload_of(hex).try_into().unwrap()
}

fn payload_of(hex: &Value) -> Vec<u8> {
    let (pairs, []) = hex.as_str().unwrap().as_bytes().as_chunks::<2>() else {
        panic!("{hex}");
    };
    let byte = |pair: &[u8; 2]| u8::from_str_radix(str::from_utf8(pair).unwrap(), 16).unwrap();
    pairs.iter().map(byte).collect()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|it| format!("{it:02x}")).collect()
}

fn text(value: &Value) -> String {
    value.as_str().unwrap().to_owned()
}

fn vectors() -> Vec<Value> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/vectors/ring.json");
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}
