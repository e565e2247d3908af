//! Replays `tests/vectors/link.json`, the golden vectors of the link frames.
//!
//! Each vector describes one end of a link: `role`, `link`, `version`, `reliable`, `sealed`,
//! `depth`, `max_borrowed`, `ring` if it offers the ring lane, and `max_len` if that is not 1 GiB,
//! in units of 1,024 bytes. Its own OPEN states `window` and `max_len`.
//! The steps are:
//!
//! 1. The end receives the datagrams of `before`.
//! 2. It sends ATTACH and DETACH for each segment of `detaches`.
//! 3. It sends `sends` messages without payload: DATA and REQUEST with ids 1, 2, 3, …; REPLY to
//!    calls 1, 2, 3, ….
//! 4. It receives the datagrams of `then`.
//! 5. It receives `hex` with the descriptors `fds`. The result is `frame`, which encodes to `hex`
//!    again, or the `violation`. With `control_truncated`, the end lost further descriptors; if one
//!    of them belongs to the frame, the end closes the link with the code `close`.
//!
//! A datagram with `count` arrives that many times. Each time, the little-endian number at each
//! offset in `grows` is one greater than before.

// Shows DECODE-VECTORS (vector).

use std::collections::BTreeSet;

use crate::link_support::{NOW, drain, message, offer, sent};
use serde_json::{Map, Value, json};
use sm2_proto::{
    Code, Datagram, FdFacts, LinkId, Machine, Period, Seals, ViolationKind,
    link::{
        Config, End, Error, FrameKind, Input, Link, MaxLen, Publications, Role, SegmentInfo,
        Status,
        wire::{Form, Frame, Given, MessageFrame},
    },
};

#[test]
fn every_vector() {
    for vector in vectors() {
        let name = &vector["name"];
        assert_eq!(vector["to"], "node", "{name}");
        let mut link = Link::new(config(&vector));
        let open = sent(&drain(&mut link))[0].to_vec();
        match Frame::decode(&Datagram::new(&open)) {
            Ok(Frame::Open(open)) => assert_eq!(vector["window"], open.window, "{name}"),
            other => panic!("{name}: {other:?}"),
        }
        prepare(&mut link, &vector);
        let bytes = unhex(&vector["hex"]);
        let fds = fds(&vector["fds"]);
        let datagram = Datagram {
            bytes: &bytes,
            fds: &fds,
            data_truncated: vector.get("data_truncated").is_some(),
            control_truncated: vector.get("control_truncated").is_some(),
        };
        let result = link.handle(NOW, Input::Datagram(datagram));
        if let Some(expected) = vector.get("violation") {
            let Err(Error::Ended(End::Violation(violation))) = result else {
                panic!("{name}: {result:?}");
            };
            assert_eq!(violation.kind(), named(expected), "{name}");
            assert_eq!(violation.clause().to_string(), vector["clause"], "{name}");
            let close = Frame::Close(violation.code()).to_vec();
            assert_eq!(sent(&drain(&mut link))[0].to_vec(), close, "{name}");
        } else {
            assert_eq!(result, Ok(()), "{name}");
            let frame = Frame::decode(&datagram).unwrap();
            assert_eq!(Value::Object(meaning(&frame)), vector["frame"], "{name}");
            assert_eq!(frame.to_vec(), bytes, "{name}");
            check_packet(&frame, &bytes);
            check_close(&mut link, &vector);
        }
    }
}

/// An end that lost the frame's descriptor closes the link.
fn check_close(link: &mut Link, vector: &Value) {
    if let Some(code) = vector.get("close").and_then(Value::as_u64) {
        let code = Code(u16::try_from(code).unwrap());
        assert_eq!(link.end(), Some(End::Local(code)), "{}", vector["name"]);
        let close = Frame::Close(code).to_vec();
        let first = sent(&drain(link)).first().map(|it| it.to_vec());
        assert_eq!(first, Some(close), "{}", vector["name"]);
    }
}

/// The first part of a packet is the frame's header.
fn check_packet(frame: &Frame<'_>, bytes: &[u8]) {
    assert!(bytes.starts_with(&frame.head()));
}

#[test]
fn every_kind_form_and_violation_has_a_vector() {
    let vectors = vectors();
    let missing = |wanted: Vec<String>, has: &dyn Fn(&Value) -> Option<String>| {
        let had: BTreeSet<_> = vectors.iter().filter_map(has).collect();
        wanted
            .into_iter()
            .filter(|it| !had.contains(it))
            .collect::<Vec<_>>()
    };
    let links = ViolationKind::ALL
        .iter()
        .filter(|it| (16..=20).contains(&it.code().0) || it.code().0 >= 64)
        // `BadWord` concerns words of a ring, which are in no frame: see `ring_vectors.rs`.
        .filter(|it| **it != ViolationKind::BadWord);
    let violations = links.map(|it| it.name().to_owned()).collect();
    let text = |value: &Value| value.as_str().unwrap().to_owned();
    assert!(missing(violations, &|it| it.get("violation").map(text)).is_empty());
    let kinds = FrameKind::ALL
        .map(|kind| format!("{kind:?}").to_uppercase())
        .to_vec();
    assert!(missing(kinds, &|it| it.get("frame").map(|it| text(&it["kind"]))).is_empty());
    let forms = ["DATA", "REQUEST", "REPLY"]
        .iter()
        .flat_map(|kind| ["inline", "pooled", "sealed"].map(|form| format!("{kind} {form}")))
        .collect();
    let form = |it: &Value| {
        let frame = it.get("frame")?;
        Some(format!(
            "{} {}",
            text(&frame["kind"]),
            text(frame.get("form")?)
        ))
    };
    assert!(missing(forms, &form).is_empty());
}

fn vectors() -> Vec<Value> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/vectors/link.json");
    let text = std::fs::read_to_string(path).unwrap();
    serde_json::from_str(&text).unwrap()
}

fn config(vector: &Value) -> Config {
    let number = |key: &str| u16::try_from(vector[key].as_u64().unwrap()).unwrap();
    let role = vector["role"].as_str().unwrap();
    let link = |key: &str| vector["link"][key].as_u64().unwrap();
    let period = |key: &str| Period(vector.get(key).map_or(0, |it| it.as_u64().unwrap()));
    Config {
        id: LinkId {
            epoch: link("epoch"),
            serial: link("serial"),
        },
        version: number("version"),
        role: Role::ALL
            .into_iter()
            .find(|it| name_of(*it) == role)
            .unwrap(),
        reliable: vector["reliable"].as_bool().unwrap(),
        sealed: vector["sealed"].as_bool().unwrap(),
        ring: vector.get("ring").is_some_and(|it| it.as_bool().unwrap()),
        depth: number("depth"),
        max_borrowed: number("max_borrowed"),
        max_len: (vector.get("max_len")).map_or(MaxLen::DEFAULT, |it| {
            MaxLen::from_bytes(1_024 * it.as_u64().unwrap())
        }),
        deadline: Period::NONE,
        lifespan: period("lifespan"),
        lease: period("lease"),
        publications: Publications::UNKNOWN,
    }
}

fn prepare(link: &mut Link, vector: &Value) {
    replay(link, &vector["before"]);
    let detaches = vector.get("detaches").and_then(Value::as_array);
    for id in detaches.into_iter().flatten() {
        detach(link, u32::try_from(id.as_u64().unwrap()).unwrap());
    }
    for id in 1..=vector.get("sends").map_or(0, |it| it.as_u64().unwrap()) {
        let sent = offer(link, message(id));
        assert_eq!(sent, Ok(()), "{}", vector["name"]);
        drain(link);
    }
    if let Some(then) = vector.get("then") {
        replay(link, then);
    }
}

fn detach(link: &mut Link, segment: u32) {
    let info = SegmentInfo {
        id: segment,
        stride: 4096,
        slots: 1,
    };
    for input in [Input::Attach(info), Input::Retire { segment }] {
        assert_eq!(link.handle(NOW, input), Ok(()));
        assert_eq!(sent(&drain(link)).len(), 1);
    }
}

fn replay(link: &mut Link, datagrams: &Value) {
    for datagram in datagrams.as_array().unwrap() {
        let mut bytes = unhex(&datagram["hex"]);
        let fds = fds(&datagram["fds"]);
        for _ in 0..datagram.get("count").map_or(1, |it| it.as_u64().unwrap()) {
            let datagram_now = Datagram {
                bytes: &bytes,
                fds: &fds,
                ..Datagram::default()
            };
            assert_eq!(link.handle(NOW, Input::Datagram(datagram_now)), Ok(()));
            drain(link);
            for at in datagram
                .get("grows")
                .and_then(Value::as_array)
                .into_iter()
                .flatten()
            {
                grow(&mut bytes[usize::try_from(at.as_u64().unwrap()).unwrap()..]);
            }
        }
    }
}

fn grow(number: &mut [u8]) {
    for byte in number {
        let (sum, carries) = byte.overflowing_add(1);
        *byte = sum;
        if !carries {
            return;
        }
    }
}

/// Returns the fields of a frame by their names.
fn meaning(frame: &Frame<'_>) -> Map<String, Value> {
    let fields = match frame {
        Frame::Open(it) => json!({
            "role": Role::ALL.into_iter().find(|role| *role as u8 == it.role).map(name_of),
            "version": it.version, "window": it.window,
            "epoch": it.link.epoch, "serial": it.link.serial, "lanes": it.lanes,
            "max_len": it.max_len, "publisher": it.publications.publisher,
            "published": it.publications.published,
        }),
        Frame::Attach(it) => json!({ "segment": it.id, "stride": it.stride, "slots": it.slots }),
        Frame::Detach { segment } => json!({ "segment": segment }),
        Frame::Message(message) => of_message(message),
        Frame::Release { given, .. } => json!({
            "fate": fate(*given),
            "sequences": frame.sequences().collect::<Vec<_>>(),
        }),
        Frame::Cancel { call } => json!({ "id": call }),
        Frame::Close(Code(code)) => json!({ "code": code }),
        Frame::Ring { depth, window } => json!({ "depth": depth, "window": window }),
        Frame::Doorbell => json!({}),
        Frame::Detached { segment } => json!({ "segment": segment }),
        Frame::Alive { time } => json!({ "time": time.0 }),
    };
    let Value::Object(mut fields) = fields else {
        unreachable!()
    };
    let kind = format!("{:?}", frame.kind()).to_uppercase();
    fields.insert("kind".to_owned(), kind.into());
    fields
}

fn of_message(message: &MessageFrame<'_>) -> Value {
    let status = match message.status {
        Status::Ok => "ok",
        Status::Failed => "failed",
        Status::Cancelled => "cancelled",
        Status::DeadlinePassed => "deadline-passed",
    };
    let mut fields = json!({
        "status": status, "sequence": message.sequence, "id": message.id,
        "time": message.time.0, "len": message.len,
    });
    match message.form {
        Form::Inline => {
            fields["form"] = "inline".into();
            fields["payload"] = hex(message.rest).into();
        }
        Form::Pooled { segment, slot } => {
            fields["form"] = "pooled".into();
            fields["segment"] = segment.into();
            fields["slot"] = slot.into();
        }
        Form::Sealed => fields["form"] = "sealed".into(),
    }
    fields
}

fn name_of(role: Role) -> String {
    format!("{role:?}").to_lowercase()
}

fn named(violation: &Value) -> ViolationKind {
    let name = violation.as_str().unwrap();
    *ViolationKind::ALL
        .iter()
        .find(|it| it.name() == name)
        .unwrap()
}

fn fds(list: &Value) -> Vec<FdFacts> {
    let facts = |it: &Value| FdFacts {
        regular: it["regular"].as_bool().unwrap(),
        size_bytes: it["size"].as_u64().unwrap(),
        seals: Seals(u32::try_from(it["seals"].as_u64().unwrap()).unwrap()),
    };
    list.as_array().unwrap().iter().map(facts).collect()
}

fn unhex(text: &Value) -> Vec<u8> {
    let text = text.as_str().unwrap();
    (0..text.len())
        .step_by(2)
        .map(|at| u8::from_str_radix(&text[at..at + 2], 16).unwrap())
        .collect()
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

const fn fate(given: Given) -> &'static str {
    match given {
        Given::Consumed => "consumed",
        Given::Discarded => "discarded",
        Given::Expired => "expired",
    }
}
