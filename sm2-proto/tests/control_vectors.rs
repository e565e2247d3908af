//! Replays `tests/vectors/control.json`, the golden vectors of control frames.
//!
//! A vector is one datagram `to` the Manager or a node, with `fds` descriptors, in a session after
//! `before`. `before` lists frames that were received and, with `>` in front, frames that the
//! receiver had sent itself. (The Manager's own frames follow from those it received; its epoch is
//! 1, the session its first; `deny` stands for an access policy that it reads and that denies
//! everything.) `truncated` names what the kernel cut, and `file` the kind of a
//! descriptor that is not a file of counters. The vector is either a `frame`, in SPEC's words, or a
//! `violation`. `answer` lists the frames that a node sends at once.

// Shows DECODE-VECTORS (vector).

use crate::naive;

use std::{collections::BTreeSet, sync::Arc};

use serde::Deserialize;
use serde_json::{Map, Value};
use sm2_proto::{
    Code, Datagram, FdFacts, Instant, Machine, NodeId, Seals, Violation, ViolationKind,
    control::{
        Limits, SchemaText, ToManager, ToNode, decode_to_manager, decode_to_node,
        encode_to_manager, encode_to_node,
    },
    manager::{Cause, Credentials, Input, Manager, Output},
    node::{self, End, Node},
    policy::{AccessPolicy, Effect, Tables},
};

const VECTORS: &str = include_str!("../../tests/vectors/control.json");
const NOW: Instant = Instant(0);
const SESSION: NodeId = NodeId(1);

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Vector {
    name: String,
    clause: String,
    to: Receiver,
    before: Vec<String>,
    hex: String,
    fds: usize,
    truncated: Option<Truncated>,
    file: Option<File>,
    frame: Option<Value>,
    answer: Option<Vec<String>>,
    violation: Option<String>,
}

#[derive(Clone, Copy, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
enum Receiver {
    Manager,
    Node,
}

#[derive(Clone, Copy, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
enum Truncated {
    Data,
    Control,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    regular: bool,
    size: u64,
    seals: u32,
}

/// The facts about each descriptor, unless a vector states others.
const COUNTERS: FdFacts = FdFacts {
    regular: true,
    size_bytes: 1_024,
    seals: Seals::POOLED,
};

fn vectors() -> Vec<Vector> {
    serde_json::from_str(VECTORS).expect("the file is what the module says")
}

fn bytes(hex: &str) -> Vec<u8> {
    let digit = |at| u8::from_str_radix(&hex[at..at + 2], 16).expect("two digits");
    (0..hex.len()).step_by(2).map(digit).collect()
}

/// The fields of a frame of the shipped codec, in SPEC's words.
fn meaning(frame: &impl serde::Serialize) -> Value {
    let frame = serde_json::to_value(frame).expect("a frame has a meaning");
    let (kind, fields) = match frame {
        Value::String(kind) => (kind, Map::new()),
        Value::Object(variant) => match variant.into_iter().next() {
            Some((kind, Value::Object(fields))) => (kind, fields),
            other => panic!("{other:?} has fields"),
        },
        other => panic!("{other} is not a variant"),
    };
    let Value::Object(fields) = spell(fields.into()) else {
        panic!("{kind} has fields");
    };
    let mut meaning = Map::new();
    meaning.insert("kind".into(), words(&kind, '_').to_uppercase().into());
    meaning.extend(fields);
    meaning.into()
}

/// Variants as SPEC spells them. Names in the vectors are in small letters.
fn spell(value: Value) -> Value {
    match value {
        Value::Object(fields) => {
            let fields = fields.into_iter();
            fields
                .map(|(key, value)| (words(&key, '-'), spell(value)))
                .collect()
        }
        Value::Array(items) => items.into_iter().map(spell).collect(),
        Value::String(text) if !NAMES.contains(&text.as_str()) => words(&text, '-').into(),
        other => other,
    }
}

/// A name that looks like a variant.
const NAMES: [&str; 3] = ["Scan", "sensor/Image", "Az_09-/b"];

fn words(variant: &str, between: char) -> String {
    let mut words = String::new();
    for letter in variant.chars() {
        if letter.is_ascii_uppercase() && !words.is_empty() {
            words.push(between);
        }
        words.push(letter.to_ascii_lowercase());
    }
    words
}

impl Vector {
    /// Calls `handle` with the datagram.
    fn datagram<T>(&self, handle: impl FnOnce(Datagram<'_>) -> T) -> T {
        let file = self.file.map_or(COUNTERS, |file| FdFacts {
            regular: file.regular,
            size_bytes: file.size,
            seals: Seals(file.seals),
        });
        handle(Datagram {
            bytes: &bytes(&self.hex),
            fds: &vec![file; self.fds],
            data_truncated: self.truncated == Some(Truncated::Data),
            control_truncated: self.truncated == Some(Truncated::Control),
        })
    }

    /// The datagram as the two decoders see it, without a session.
    fn decode(&self) {
        let bytes = bytes(&self.hex);
        let decoded = self.datagram(|datagram| match self.to {
            Receiver::Manager => decode_to_manager(&datagram)
                .map(|frame| (meaning(&frame), encode_to_manager(&frame))),
            Receiver::Node => {
                decode_to_node(&datagram).map(|frame| (meaning(&frame), encode_to_node(&frame)))
            }
        });
        if let Ok((_, again)) = &decoded {
            assert_eq!(*again, bytes, "{}", self.name);
        }
        match (&self.frame, &decoded) {
            (Some(frame), Ok((meaning, _))) => assert_eq!(frame, meaning, "{}", self.name),
            (Some(_), Err(violation)) => panic!("{}: {violation}", self.name),
            (None, _) => {}
        }
        if self.truncated != Some(Truncated::Data) {
            let lost = self.truncated.is_some();
            let naive = match self.to {
                Receiver::Manager => naive::to_manager(&bytes, self.fds, lost),
                Receiver::Node => naive::to_node(&bytes, self.fds, lost),
            };
            let decoded = decoded.map(drop).map_err(|it| it.kind().name());
            assert_eq!(decoded, naive.map(drop), "{}", self.name);
        }
    }

    /// The effect of the datagram in its session: the violation, and the code of the goodbye that
    /// goes out.
    fn replay(&self) -> Option<(Violation, Code)> {
        match self.to {
            Receiver::Manager => self.replay_to_manager(),
            Receiver::Node => self.replay_to_node(),
        }
    }

    fn replay_to_manager(&self) -> Option<(Violation, Code)> {
        let mut manager = Manager::new(1, 7, Limits::default()).with_owner(1000);
        let mut feed = |input: Input<'_>| {
            manager
                .handle(NOW, input)
                .expect("the driver keeps the contract");
            std::iter::from_fn(|| manager.poll()).find_map(|output| match output {
                Output::HangUp { goodbye, cause, .. } => Some((goodbye, cause)),
                _ => None,
            })
        };
        let credentials = Credentials {
            uid: 1000,
            gid: 1000,
            pid: 1,
        };
        let session = SESSION;
        assert_eq!(
            feed(Input::Connected {
                session,
                credentials
            }),
            None
        );
        for before in &self.before {
            if before == "deny" {
                assert_eq!(feed(Input::SetAccessPolicy(Some(denying()))), None);
                assert_eq!(feed(Input::Tick), None);
                continue;
            }
            let bytes = bytes(before);
            let has_file = matches!(bytes.first(), Some(9));
            let datagram = Datagram {
                fds: &[COUNTERS][..usize::from(has_file)],
                ..Datagram::new(&bytes)
            };
            let hung_up = feed(Input::Datagram { session, datagram });
            assert_eq!(hung_up, None, "{}: {before}", self.name);
        }
        match self.datagram(|datagram| feed(Input::Datagram { session, datagram })) {
            Some((goodbye, Cause::Violation(violation))) => {
                let goodbye = goodbye.expect("a violation is answered");
                match decode_to_node(&Datagram::new(&goodbye)) {
                    Ok(ToNode::Goodbye { code }) => Some((violation, code)),
                    other => panic!("{other:?} is not a goodbye"),
                }
            }
            Some((None, Cause::Goodbye(_))) | None => None,
            Some(other) => panic!("{}: {other:?}", self.name),
        }
    }

    fn replay_to_node(&self) -> Option<(Violation, Code)> {
        let mut before = self.before.iter();
        let hello = before.next().expect("a node greets first");
        let hello = bytes(hello.strip_prefix('>').expect("a node greets itself"));
        let Ok(ToManager::Hello { name, .. }) = decode_to_manager(&Datagram::new(&hello)) else {
            panic!("{}: a node greets first", self.name);
        };
        let mut node = Node::new(name);
        let mut sent = transmitted(&mut node);
        assert_eq!(sent.pop(), Some(hello));
        for before in before {
            match before.strip_prefix('>') {
                Some(hex) => {
                    if !sent.contains(&bytes(hex)) {
                        act(&mut node, &bytes(hex));
                        sent.extend(transmitted(&mut node));
                    }
                    assert!(sent.contains(&bytes(hex)), "{}: {before}", self.name);
                }
                None => {
                    let bytes = bytes(before);
                    let has_file = matches!(bytes.first(), Some(4 | 10));
                    let datagram = Datagram {
                        fds: &[COUNTERS][..usize::from(has_file)],
                        ..Datagram::new(&bytes)
                    };
                    let received = node.handle(NOW, node::Input::Datagram(datagram));
                    assert_eq!(received, Ok(()), "{}: {before}", self.name);
                    sent.extend(transmitted(&mut node));
                }
            }
        }
        let handled = self.datagram(|datagram| node.handle(NOW, node::Input::Datagram(datagram)));
        match handled {
            Ok(()) => {
                if let Some(answer) = &self.answer {
                    let answer: Vec<_> = answer.iter().map(|hex| bytes(hex)).collect();
                    assert_eq!(transmitted(&mut node), answer, "{}", self.name);
                }
                None
            }
            Err(node::Error::Ended(End::Violation(violation))) => {
                let goodbye = transmitted(&mut node)
                    .pop()
                    .expect("a violation is answered");
                match decode_to_manager(&Datagram::new(&goodbye)) {
                    Ok(ToManager::Goodbye { code }) => Some((violation, code)),
                    other => panic!("{other:?} is not a goodbye"),
                }
            }
            Err(error) => panic!("{}: {error}", self.name),
        }
    }
}

/// An access policy that allows nothing.
fn denying() -> Arc<AccessPolicy> {
    let tables = Tables {
        default: Effect::Deny,
        rules: Vec::new(),
        bindings: Vec::new(),
        exclusive: Vec::new(),
    };
    Arc::new(AccessPolicy::new(tables).expect("within the limits"))
}

fn transmitted(node: &mut Node) -> Vec<Vec<u8>> {
    let outputs = std::iter::from_fn(|| node.poll());
    let sent = outputs.filter_map(|output| match output {
        node::Output::Transmit(bytes) | node::Output::TransmitCounters(bytes) => Some(bytes),
        _ => None,
    });
    sent.collect()
}

/// Makes a node send a frame.
fn act(node: &mut Node, bytes: &[u8]) {
    let has_file = matches!(bytes.first(), Some(9));
    let datagram = Datagram {
        fds: &[COUNTERS][..usize::from(has_file)],
        ..Datagram::new(bytes)
    };
    let input = match decode_to_manager(&datagram).expect("a node sends it") {
        ToManager::Declare { contract, .. } => {
            node.declare(contract).expect("legal");
            return;
        }
        ToManager::Hello { name, .. } => node::Input::Greet(name),
        ToManager::Withdraw { interface } => node::Input::Withdraw { interface },
        ToManager::Unlinked {
            interface,
            link,
            code,
        } => node::Input::Unlinked {
            interface,
            link,
            code,
        },
        ToManager::Query { after } => node::Input::Query { after },
        ToManager::Goodbye { code } => node::Input::Close(code),
        ToManager::Watch { after } => node::Input::Watch { after },
        ToManager::Counters => node::Input::Counters,
        ToManager::Inspect { node } => node::Input::Inspect { node },
        ToManager::Schema(SchemaText { data, text }) => {
            node::Input::Schema(SchemaText { data, text })
        }
        ToManager::Describe { data } => node::Input::Describe { data },
        ToManager::Reload => node::Input::Reload,
        other => panic!("{other:?} follows from a resumption"),
    };
    node.handle(NOW, input).expect("legal");
}

//= SM2-FRM-001, SM2-FRM-002, SM2-COD-001 vector
#[test]
fn every_vector() {
    for vector in vectors() {
        vector.decode();
        let expected = vector.violation.as_ref().map(|name| {
            let mut all = ViolationKind::ALL.iter();
            *all.find(|it| it.name() == name).expect("SPEC names it")
        });
        let found = vector.replay();
        let kinds = found.map(|(violation, code)| (violation.kind(), code));
        assert_eq!(kinds, expected.map(|it| (it, it.code())), "{}", vector.name);
        if let Some((violation, _)) = found {
            assert_eq!(
                violation.clause().to_string(),
                vector.clause,
                "{}",
                vector.name
            );
        }
        let either = vector.frame.is_some() != vector.violation.is_some();
        assert!(either, "{}: a frame or a violation", vector.name);
        assert!(vector.clause.starts_with("SM2-"), "{}", vector.name);
    }
}

/// Every variant of the enumerations in frames.
const VARIANTS: [&str; 36] = [
    "publisher",
    "subscriber",
    "server",
    "client",
    "name-taken",
    "version",
    "topic-type",
    "service-type",
    "quota",
    "denied",
    "exclusive",
    "sessions-per-user",
    "interfaces-per-session",
    "interfaces-per-user",
    "links-per-session",
    "sessions-per-process",
    "interfaces-per-process",
    "domain",
    "node",
    "interface",
    "refusal",
    "link",
    "claim",
    "unlinked",
    "ended",
    "descriptors",
    "set",
    "removed",
    "member",
    "applied",
    "no-policy",
    "not-permitted",
    "unusable",
    "unreadable",
    "not-trusted",
    "invalid",
];

#[test]
fn every_frame_variant_and_control_violation_has_a_vector() {
    let vectors = vectors();
    let mut kinds = BTreeSet::new();
    let mut variants = BTreeSet::new();
    let mut violations = BTreeSet::new();
    for vector in &vectors {
        if let Some(frame) = &vector.frame {
            kinds.insert((vector.to as u8, frame["kind"].as_str().expect("a kind")));
            variants.insert(frame.to_string());
        }
        violations.extend(vector.violation.as_deref());
    }
    assert_eq!(kinds.len(), 16 + 15);
    for variant in VARIANTS {
        let with_fields = format!("\"{variant}\":{{");
        let without = format!(":\"{variant}\"");
        let mut frames = variants.iter();
        let found = frames.any(|it| it.contains(&with_fields) || it.contains(&without));
        assert!(found, "{variant}");
    }
    // The violations of sessions, and of the one descriptor that a node hands over.
    let of_files = [
        ViolationKind::NotAMemfd,
        ViolationKind::SealsMissing,
        ViolationKind::BadSize,
    ];
    let control = ViolationKind::ALL
        .iter()
        .filter(|violation| violation.code().0 < 64 || of_files.contains(violation));
    let control: BTreeSet<&str> = control.map(|violation| violation.name()).collect();
    assert_eq!(violations, control);
    let names: BTreeSet<_> = vectors.iter().map(|it| (it.to as u8, &it.name)).collect();
    assert_eq!(names.len(), vectors.len(), "names tell vectors apart");
}
