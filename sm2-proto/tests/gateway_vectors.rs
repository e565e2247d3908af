//! Replays `tests/vectors/gateway.json`, the golden vectors of gateways.
//!
//! The receiver is gateway 1: its id is 32 bytes of 1, its epoch 71. The sender is gateway 2; the
//! greatest epoch of gateway 2 that the receiver has seen is 70. A vector of the control stream or
//! of another stream begins after `before`: bytes of the control stream that the receiver read and,
//! with `>` in front, frames that it sent on its own. Then the peer has made `offers` offers,
//! numbered from 1, and the receiver has made a `call` of one of them on the stream of the vector.

// Shows GW-DECODE, GW-SESSION (vector).

use std::collections::BTreeSet;

use crate::gateway::{agreement, json};
use serde::Deserialize;
use serde_json::Value;
use sm2_proto::{
    Error, Instant, Machine, Name, TypeId,
    gateway::{
        Beacon, Frame, FrameReader, GatewayId, Header, Hop, OfferId, PeerFarewell,
        PeerViolationKind, StreamToken, Subject,
        session::{Command, ControlCommand, End, Input, Output, PeerEvent, PeerSession, Transport},
    },
};

const VECTORS: &str = include_str!("../../tests/vectors/gateway.json");
const NOW: Instant = Instant(0);
const STREAM: u64 = 4;
const PEER: Hop = Hop {
    gateway: GatewayId([2; 32]),
    epoch: 72,
};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Vector {
    name: String,
    clause: String,
    to: Program,
    of: Surface,
    #[serde(default)]
    before: Vec<String>,
    #[serde(default)]
    offers: u64,
    call: Option<u64>,
    hex: String,
    frame: Option<Value>,
    /// The frames that the receiver sends at once.
    #[serde(default)]
    answer: String,
    header: Option<Value>,
    /// The fate of the stream: taken, discarded or unreachable.
    stream: Option<String>,
    violation: Option<String>,
    /// The name of the code that closes the connection without a violation, at the receiver.
    closed: Option<String>,
    beacon: Option<Value>,
    ignored: Option<String>,
}

/// The programs that receive a vector of this file.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
enum Program {
    Gateway,
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
enum Surface {
    /// The control stream.
    Control,
    /// The header of another stream.
    Stream,
    /// A datagram to the multicast group.
    Beacon,
}

/// The outputs of an input, or the end of the session.
type Outcome = Result<Vec<Output>, End>;

fn vectors() -> Vec<Vector> {
    serde_json::from_str(VECTORS).expect("the file is what the module says")
}

fn bytes(hex: &str) -> Vec<u8> {
    let digit = |at| u8::from_str_radix(&hex[at..at + 2], 16).expect("two digits");
    (0..hex.len()).step_by(2).map(digit).collect()
}

fn name(text: &str) -> Name {
    Name::new(text).expect("legal")
}

fn feed(session: &mut PeerSession, input: Input<'_>) -> Outcome {
    let fed = session.handle(NOW, input);
    let outputs = std::iter::from_fn(|| session.poll()).collect();
    match (fed, session.end()) {
        (Ok(()), None) => Ok(outputs),
        (Ok(()), Some(end)) => Err(end),
        (Err(Error::Ended(end)), ended) => {
            assert_eq!(ended, Some(end));
            Err(end)
        }
        (Err(Error::Misuse(misuse)), _) => panic!("the driver broke the contract: {misuse}"),
    }
}

impl Vector {
    /// The session after `before`, `offers` and `call`.
    fn session(&self) -> PeerSession {
        let me = Hop {
            gateway: GatewayId([1; 32]),
            epoch: 71,
        };
        let mut session = PeerSession::new(NOW, me, name("me"), PEER.gateway, 70);
        while session.poll().is_some() {}
        for before in &self.before {
            let fed = match before.strip_prefix('>') {
                Some(hex) => feed(&mut session, said(&bytes(hex))),
                None => feed(
                    &mut session,
                    Input::Event(PeerEvent::Control(&bytes(before))),
                ),
            };
            fed.unwrap_or_else(|end| panic!("{}: {before}: {end:?}", self.name));
        }
        for offer in 1..=self.offers {
            let frame = Frame::Offer {
                offer: OfferId(offer),
                subject: Subject::Topic {
                    name: name("scan"),
                    data: TypeId {
                        name: name("Scan"),
                        hash: 7,
                    },
                    reliable: true,
                    latched: 0,
                },
                path: vec![PEER],
            };
            let fed = feed(
                &mut session,
                Input::Event(PeerEvent::Control(&frame.to_bytes())),
            );
            fed.unwrap_or_else(|end| panic!("{}: {offer}: {end:?}", self.name));
        }
        if let Some(offer) = self.call {
            let stream = STREAM;
            let fed = feed(
                &mut session,
                Input::Command(Command::Call {
                    stream: StreamToken(stream),
                    offer: OfferId(offer),
                }),
            );
            assert_eq!(fed, Ok(vec![]), "{}", self.name);
        }
        session
    }

    fn check_control(&self) {
        let (name, bytes) = (&self.name, bytes(&self.hex));
        agreement::stream(&bytes, &[3]);
        agreement::body(bytes.get(4..).unwrap_or_default());
        let mut reader = FrameReader::default();
        reader.push(&bytes);
        let read = reader.next_frame();
        if let Ok(frame) = &read {
            let frame = frame.as_ref().expect("all of it is there");
            assert_eq!(frame.to_bytes(), bytes, "{name}");
            assert!(reader.is_between_frames(), "{name}");
            if let Some(expected) = &self.frame {
                assert_eq!(*expected, json::frame(frame), "{name}");
            }
        }
        let outcome = feed(
            &mut self.session(),
            Input::Event(PeerEvent::Control(&bytes)),
        );
        match (&self.frame, outcome) {
            (Some(_), Ok(outputs)) => {
                let sent = outputs.into_iter().filter_map(|output| match output {
                    Output::Transmit(bytes) => Some(bytes),
                    _ => None,
                });
                let sent: Vec<Vec<u8>> = sent.collect();
                assert_eq!(sent.concat(), self::bytes(&self.answer), "{name}");
            }
            (None, Err(end)) => self.check_end(end),
            (_, other) => panic!("{name}: {other:?}"),
        }
    }

    fn check_stream(&self) {
        let (name, bytes) = (&self.name, bytes(&self.hex));
        let bytes = bytes.try_into().expect("as long as a header");
        agreement::header(&bytes);
        let read = Header::from_bytes(&bytes);
        if let Ok(header) = &read {
            assert_eq!(header.to_bytes(), bytes, "{name}");
        }
        if let Some(expected) = &self.header {
            let header = read.as_ref().map(json::header);
            assert_eq!(header.as_ref(), Ok(expected), "{name}");
        }
        let mut session = self.session();
        let outcome = match read {
            Ok(header) => feed(
                &mut session,
                Input::Event(PeerEvent::Header {
                    transport: Transport::Stream(StreamToken(STREAM)),
                    header,
                }),
            ),
            Err(violation) => Err(End::Violation(violation)),
        };
        match outcome {
            Ok(outputs) => {
                let stream = STREAM;
                let expected = match self.stream.as_deref() {
                    Some("taken") => Output::Take {
                        transport: Transport::Stream(StreamToken(stream)),
                    },
                    Some("discarded") => Output::Discard {
                        transport: Transport::Stream(StreamToken(stream)),
                    },
                    Some("unreachable") => Output::Unreachable {
                        stream: StreamToken(stream),
                    },
                    other => panic!("{name}: {other:?}"),
                };
                assert_eq!(outputs, [expected], "{name}");
            }
            Err(end) => self.check_end(end),
        }
    }

    fn check_end(&self, end: End) {
        let Self {
            violation, closed, ..
        } = self;
        match (violation.as_deref(), closed.as_deref(), end) {
            (Some(kind), None, End::Violation(found)) => {
                let expected = format!("{kind} ({})", self.clause);
                assert_eq!(found.to_string(), expected, "{}", self.name);
            }
            (None, Some(name), _) => {
                let farewell = PeerFarewell::ALL.iter().find(|it| it.name() == name);
                let expected = End::Local(farewell.expect("SPEC names it").code());
                assert_eq!(end, expected, "{}", self.name);
            }
            other => panic!("{}: {other:?}", self.name),
        }
    }

    fn check_beacon(&self) {
        let (name, bytes) = (&self.name, bytes(&self.hex));
        agreement::beacon(&bytes);
        let read = Beacon::from_bytes(&bytes);
        if let Ok(beacon) = &read {
            assert_eq!(beacon.to_bytes().as_slice(), bytes, "{name}");
        }
        let meaning = read.as_ref().ok().map(json::beacon);
        assert_eq!(meaning, self.beacon, "{name}");
        let why = read.err().map(json::beacon_error);
        assert_eq!(why, self.ignored.as_deref(), "{name}");
    }
}

/// The command that makes a session send these bytes.
fn said(bytes: &[u8]) -> Input<'static> {
    match Frame::from_body(&bytes[4..]).expect("a gateway sends it") {
        Frame::Offer {
            offer,
            subject,
            path,
        } => Input::Command(Command::Offer {
            offer,
            subject,
            path,
        }),
        Frame::Unoffer { offer } => {
            Input::Command(Command::Control(ControlCommand::Unoffer { offer }))
        }
        Frame::Want { offer, depth } => {
            Input::Command(Command::Control(ControlCommand::Want { offer, depth }))
        }
        Frame::Unwant { offer } => {
            Input::Command(Command::Control(ControlCommand::Unwant { offer }))
        }
        Frame::Ask { ask, kind, name } => {
            Input::Command(Command::Control(ControlCommand::Ask { ask, kind, name }))
        }
        Frame::Answer { ask, verdict } => {
            Input::Command(Command::Control(ControlCommand::Answer { ask, verdict }))
        }
        other => panic!("{other:?} follows from what came"),
    }
}

//= SM2-GWF-002, SM2-GWM-002, SM2-GWD-001 vector
#[test]
fn every_vector() {
    for vector in vectors() {
        match (vector.to, vector.of) {
            (Program::Gateway, Surface::Control) => vector.check_control(),
            (Program::Gateway, Surface::Stream) => vector.check_stream(),
            (Program::Gateway, Surface::Beacon) => vector.check_beacon(),
        }
        let outcomes = [
            vector.frame.is_some(),
            vector.header.is_some() && vector.stream.is_some(),
            vector.violation.is_some(),
            vector.closed.is_some(),
            vector.beacon.is_some(),
            vector.ignored.is_some(),
        ];
        let count = outcomes.iter().filter(|it| **it).count();
        assert_eq!(count, 1, "{}: one outcome", vector.name);
        assert!(vector.clause.starts_with("SM2-"), "{}", vector.name);
    }
}

#[test]
fn every_kind_and_violation_has_a_vector() {
    let vectors = vectors();
    let frames: Vec<_> = vectors.iter().filter_map(|it| it.frame.as_ref()).collect();
    assert_eq!(kinds(&frames).len(), 9);
    let texts: String = frames.iter().map(ToString::to_string).collect();
    for variant in ["topic", "service", "offered", "denied", "absent"] {
        let with_fields = format!("\"{variant}\":{{");
        let without = format!(":\"{variant}\"");
        let found = texts.contains(&with_fields) || texts.contains(&without);
        assert!(found, "{variant}");
    }
    let headers: Vec<_> = vectors.iter().filter_map(|it| it.header.as_ref()).collect();
    assert_eq!(kinds(&headers).len(), 3);
    let statuses = headers
        .iter()
        .filter_map(|it| it["reply"]["status"].as_str());
    assert_eq!(statuses.collect::<BTreeSet<_>>().len(), 6);
    let streams = vectors.iter().filter_map(|it| it.stream.as_deref());
    assert_eq!(streams.collect::<BTreeSet<_>>().len(), 3);
    let violations = vectors.iter().filter_map(|it| it.violation.as_deref());
    let all = PeerViolationKind::ALL.iter().map(|it| it.name());
    assert_eq!(
        violations.collect::<BTreeSet<_>>(),
        all.collect::<BTreeSet<_>>()
    );
    let ignored = vectors.iter().filter_map(|it| it.ignored.as_deref());
    assert_eq!(ignored.collect::<BTreeSet<_>>().len(), 5);
    let names: BTreeSet<_> = vectors.iter().map(|it| &it.name).collect();
    assert_eq!(names.len(), vectors.len(), "names tell vectors apart");
}

/// The keys of all objects: the variants with fields.
fn kinds(values: &[&Value]) -> BTreeSet<String> {
    let keys = values.iter().filter_map(|it| it.as_object());
    keys.flat_map(|it| it.keys().cloned()).collect()
}
