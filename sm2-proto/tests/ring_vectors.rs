//! Replays `tests/vectors/ring.json`, the golden vectors of the words of a ring.
//!
//! `tests/vectors/README.md` describes the fields. The other end of each link exists only to open
//! the link: `image` and `before` replace all words that it would have written.

// Shows RNG-INDEX, RNG-FIFO, RNG-HOSTILE (vector).

use std::collections::{BTreeMap, BTreeSet};

use crate::ring_support::{RECEIVER, Rig, SENDER, ring_config, segment};
use serde_json::{Value, json};
use sm2_proto::{
    Period, Violation,
    limits::SLOT_HEAD,
    link::{Config, End, Error, Fate, Input, LentRing, Misuse, NoDelivery, Payload, Role, Wake},
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
    let expected = ["003", "004", "005", "006", "007", "008", "012"];
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
            let slot = u32::try_from(of["slot"].as_u64().unwrap()).unwrap();
            let sent = rig.send(of["id"].as_u64().unwrap(), slot);
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
            let Payload::Pooled { offset, .. } = it.payload else {
                panic!("{it:?}");
            };
            Outcome::Result(json!({
                "sequence": it.sequence, "id": it.id, "slot": offset / segment(0).stride,
                "len": it.len, "time": it.time.0, "lost": it.lost,
            }))
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
        Error::Misuse(Misuse::NoRoom) => Outcome::Result(json!({ "refused": "no-room" })),
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
    let hex = hex.as_str().unwrap();
    assert_eq!(hex.len(), 2 * N, "{hex}");
    std::array::from_fn(|at| u8::from_str_radix(&hex[2 * at..2 * at + 2], 16).unwrap())
}

fn text(value: &Value) -> String {
    value.as_str().unwrap().to_owned()
}

fn vectors() -> Vec<Value> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/vectors/ring.json");
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}
