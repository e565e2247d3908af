//! Random rules, their meaning as a plain list, and the paths that they allow.

use std::time::Duration;

use sm2_gateway::hub::{DEFAULT_SEND_QOS, Policy};
use sm2_proto::{
    Name, TypeId,
    gateway::{
        Action, Direction, GatewayId, Pattern, Rule, Rules, Subject, SubjectKind, schedule::SendQos,
    },
};

use super::random::Random;

const TOPICS: [&str; 3] = ["a/x", "a/y", "b"];
const SERVICES: [&str; 2] = ["a/x", "s"];
/// Patterns, each with all the names that it matches.
const PATTERNS: [(&str, &[&str]); 8] = [
    ("**", &["a/x", "a/y", "b", "s"]),
    ("a/**", &["a/x", "a/y"]),
    ("*", &["b", "s"]),
    ("*/x", &["a/x"]),
    ("**/y", &["a/y"]),
    ("a/x", &["a/x"]),
    ("b/**", &["b"]),
    ("s", &["s"]),
];

fn name(text: &str) -> Name {
    Name::new(text).unwrap()
}

fn type_id(text: &str) -> TypeId {
    let (name, hash) = (name(text), 7);
    TypeId { name, hash }
}

/// All subjects that a domain can have.
pub(crate) fn subjects() -> Vec<Subject> {
    let topics = TOPICS.iter().map(|it| Subject::Topic {
        name: name(it),
        data: type_id("Text"),
        reliable: false,
        latched: 0,
    });
    let services = SERVICES.iter().map(|it| Subject::Service {
        name: name(it),
        request: type_id("Text"),
        reply: type_id("Text"),
    });
    topics.chain(services).collect()
}

#[derive(Clone, Debug)]
struct Line {
    allow: bool,
    kind: Option<SubjectKind>,
    pattern: usize,
    direction: Option<Direction>,
    peers: Option<Vec<usize>>,
    qos: SendQos,
}

/// The rules of one gateway.
#[derive(Clone, Debug, Default)]
pub(crate) struct RuleSet(Vec<Line>);

impl RuleSet {
    pub(crate) fn any(random: &mut Random, gateways: usize) -> Self {
        let mut lines = Vec::new();
        for _ in 0..random.below(4) {
            let mut line = Line::any(random);
            line.pattern = random.index(PATTERNS.len());
            line.kind =
                *random.one_of(&[None, Some(SubjectKind::Topic), Some(SubjectKind::Service)]);
            line.direction = *random.one_of(&[None, Some(Direction::In), Some(Direction::Out)]);
            line.allow = random.percent(40);
            if random.percent(50) {
                let peers = (0..gateways).filter(|_| random.percent(50));
                line.peers = Some(peers.collect());
            }
            lines.push(line);
        }
        if random.percent(85) {
            lines.push(Line::any(random));
        }
        Self(lines)
    }

    pub(crate) fn policy(&self, ids: &[GatewayId]) -> Policy {
        let rule = |line: &Line| Rule {
            action: if line.allow {
                Action::Allow
            } else {
                Action::Deny
            },
            kind: line.kind,
            names: Pattern::new(PATTERNS[line.pattern].0).unwrap(),
            direction: line.direction,
            peers: (line.peers.as_ref()).map(|it| it.iter().map(|index| ids[*index]).collect()),
        };
        Policy {
            rules: Rules(self.0.iter().map(rule).collect()),
            send_qos: self.0.iter().map(|it| it.qos).collect(),
        }
    }

    /// Evaluates the rules as SPEC defines, over lists of names.
    pub(crate) fn allows(&self, subject: &Subject, direction: Direction, peer: usize) -> bool {
        for line in &self.0 {
            let is_about = PATTERNS[line.pattern].1.contains(&subject.name().as_str())
                && (line.kind.is_none() || line.kind == Some(subject.kind()))
                && (line.direction.is_none() || line.direction == Some(direction))
                && line.peers.as_ref().is_none_or(|it| it.contains(&peer));
            if is_about {
                return line.allow;
            }
        }
        false
    }
}

impl Line {
    /// Generates random rules.
    fn any(random: &mut Random) -> Self {
        let age = Duration::from_millis(500);
        let qos = SendQos {
            priority: u8::try_from(random.below(8)).unwrap(),
            max_age: random.percent(20).then_some(age),
            messages_per_s: std::num::NonZeroU32::new(*random.one_of(&[0, 0, 20])),
            ..DEFAULT_SEND_QOS
        };
        Self {
            allow: true,
            kind: None,
            pattern: 0,
            direction: None,
            peers: None,
            qos,
        }
    }
}
