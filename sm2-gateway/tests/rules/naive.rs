//! A second implementation of rules: a plain list, simple and slow.

use std::fmt::Write;

use proptest::{collection::vec, option, prelude::*, sample::select, sample::subsequence};
use sm2_gateway::Config;
use sm2_proto::gateway::{Direction, GatewayId, SubjectKind};

pub(crate) const PEERS: [&str; 3] = ["one", "two", "three"];

pub(crate) fn id(peer: usize) -> GatewayId {
    GatewayId([u8::try_from(peer).unwrap() + 1; 32])
}

/// A rule of a configuration file.
#[derive(Clone, Debug)]
pub(crate) struct Line {
    allow: bool,
    kind: Option<SubjectKind>,
    names: String,
    direction: Option<Direction>,
    peers: Option<Vec<usize>>,
}

/// Segments that are legal in names, and now and then an illegal one that people might try.
pub(crate) fn segment() -> impl Strategy<Value = &'static str> {
    let good = select(vec!["a", "b", "A", "a-b", "a_b"]);
    // An umlaut, composed and decomposed; then a Cyrillic letter that looks like a Latin one.
    let bad = select(vec![
        "", ".", "..", "\u{e4}", "a\u{308}", "\u{430}", "a b", "%2e",
    ]);
    prop_oneof![30 => good, 1 => bad]
}

pub(crate) fn text(segment: impl Strategy<Value = &'static str>) -> impl Strategy<Value = String> {
    vec(segment, 1..4).prop_map(|it| it.join("/"))
}

fn pattern() -> impl Strategy<Value = String> {
    text(prop_oneof![3 => segment(), 1 => Just("*"), 2 => Just("**")])
}

pub(crate) fn kind() -> impl Strategy<Value = SubjectKind> {
    select(vec![SubjectKind::Topic, SubjectKind::Service])
}

pub(crate) fn lines() -> impl Strategy<Value = Vec<Line>> {
    let direction = select(vec![Direction::In, Direction::Out]);
    let peers = subsequence((0..PEERS.len()).collect::<Vec<_>>(), 1..=PEERS.len());
    let line = (
        any::<bool>(),
        option::weighted(0.3, kind()),
        pattern(),
        option::weighted(0.4, direction),
        option::weighted(0.4, peers),
    );
    let line = line.prop_map(|(allow, kind, names, direction, peers)| Line {
        allow,
        kind,
        names,
        direction,
        peers,
    });
    vec(line, 0..6)
}

/// Returns the text of the file, and the line number of each rule.
pub(crate) fn file(lines: &[Line]) -> (String, Vec<usize>) {
    let mut text = "name = \"me\"\nkey = \"key\"\n".to_owned();
    for (number, peer) in PEERS.iter().enumerate() {
        write!(
            text,
            "[[peer]]\nname = \"{peer}\"\nid = \"{}\"\n",
            id(number)
        )
        .unwrap();
    }
    let mut at = Vec::new();
    for line in lines {
        at.push(text.lines().count() + 1);
        let action = if line.allow { "allow" } else { "deny" };
        let names = &line.names;
        write!(
            text,
            "[[rule]]\naction = \"{action}\"\nnames = \"{names}\"\n"
        )
        .unwrap();
        match line.kind {
            Some(SubjectKind::Topic) => text.push_str("kind = \"topic\"\n"),
            Some(SubjectKind::Service) => text.push_str("kind = \"service\"\n"),
            None => {}
        }
        text.push_str(match line.direction {
            Some(Direction::In) => "direction = \"in\"\n",
            Some(Direction::Out) => "direction = \"out\"\n",
            None => "direction = \"both\"\n",
        });
        if let Some(peers) = &line.peers {
            let peers: Vec<_> = peers.iter().map(|it| PEERS[*it]).collect();
            writeln!(text, "peers = {peers:?}").unwrap();
        }
    }
    (text, at)
}

pub(crate) fn parse(text: &str) -> Result<Config, sm2_gateway::ConfigError> {
    Config::parse("gateway.toml".as_ref(), text)
}

pub(crate) fn is_name(text: &str) -> bool {
    let is_segment = |it: &str| {
        let is_good = |it: char| it.is_ascii_alphanumeric() || "_-".contains(it);
        !it.is_empty() && it.chars().all(is_good)
    };
    text.split('/').all(is_segment)
}

pub(crate) fn is_pattern(text: &str) -> bool {
    text.split('/')
        .all(|it| it == "*" || it == "**" || is_name(it))
}

pub(crate) fn is_good(lines: &[Line]) -> bool {
    lines.iter().all(|it| is_pattern(&it.names))
}

fn fits(pattern: &[&str], name: &[&str]) -> bool {
    match (pattern, name) {
        ([], []) => true,
        (["**", behind @ ..], _) => (0..=name.len()).any(|it| fits(behind, &name[it..])),
        ([first, behind @ ..], [segment, rest @ ..]) => {
            (*first == "*" || first == segment) && fits(behind, rest)
        }
        _ => false,
    }
}

/// Returns whether the subject passes, and the number of the deciding rule.
pub(crate) fn decide(
    lines: &[Line],
    kind: SubjectKind,
    name: &str,
    direction: Direction,
    peer: usize,
) -> (bool, Option<usize>) {
    for (number, line) in lines.iter().enumerate() {
        let pattern: Vec<_> = line.names.split('/').collect();
        let name: Vec<_> = name.split('/').collect();
        let other_peer = line.peers.as_ref().is_some_and(|it| !it.contains(&peer));
        let other_kind = line.kind.is_some_and(|it| it != kind);
        let other_direction = line.direction.is_some_and(|it| it != direction);
        if !(other_peer || other_kind || other_direction) && fits(&pattern, &name) {
            return (line.allow, Some(number));
        }
    }
    (false, None)
}
