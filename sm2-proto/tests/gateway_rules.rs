//! Patterns and rules, compared with an oracle that applies each definition directly.

// Shows GW-RULE (proptest), bound: all names of up to four of three segments; sampled patterns and lists of rules.

use crate::support::{cases, contracts::name};
use proptest::{collection::vec, prelude::*, sample::select};
use sm2_proto::{
    Name,
    gateway::{
        Action, AskId, Decision, Direction, Frame, GatewayId, GatewayIdError, Pattern,
        PatternError, PeerViolationKind, Rule, Rules, SubjectKind,
    },
    violation,
};

const PEERS: [GatewayId; 2] = [GatewayId([1; 32]), GatewayId([2; 32])];

fn pattern(text: &str) -> Pattern {
    Pattern::new(text).unwrap_or_else(|error| panic!("{text}: {error}"))
}

//= SM2-GWR-001 test
#[test]
fn patterns_and_names() {
    let table = [
        ("a", "a", true),
        ("a", "A", false),
        ("a", "a/b", false),
        ("a/b", "a", false),
        ("*", "a", true),
        ("*", "a/b", false),
        ("*/b", "a/b", true),
        ("*/b", "b", false),
        ("a/*", "a/b", true),
        ("a/*", "a", false),
        ("a/*", "a/b/c", false),
        ("**", "a", true),
        ("**", "a/b/c", true),
        ("a/**", "a", true),
        ("a/**", "a/b/c", true),
        ("a/**", "b/a", false),
        ("a/**", "ab", false),
        ("**/a", "a", true),
        ("**/a", "b/c/a", true),
        ("**/a", "a/b", false),
        ("a/**/b", "a/b", true),
        ("a/**/b", "a/b/b", true),
        ("a/**/b", "a/c/d", false),
        ("**/b/**/b", "b", false),
        ("**/b/**/b", "a/b/c/b/c/b", true),
        ("*/**", "a", true),
        ("**/**", "a/b", true),
        ("**/*/*", "a", false),
        ("a*", "ab", false),
    ];
    for (text, called, expected) in table {
        match Pattern::new(text) {
            Ok(pattern) => assert_eq!(pattern.fits(&name(called)), expected, "{text} {called}"),
            Err(error) => assert!(text == "a*" && !expected, "{text}: {error}"),
        }
    }
}

#[test]
fn texts_that_are_no_patterns() {
    let table = [
        ("", 1, "a name cannot be empty"),
        ("/a", 1, "a name cannot be empty"),
        ("a/", 2, "a name cannot be empty"),
        ("a//b", 2, "a name cannot be empty"),
        ("a/..", 2, "a name holds only"),
        ("a*", 1, "a name holds only"),
        ("*/***", 2, "a name holds only"),
        ("a/b /c", 2, "a name holds only"),
        ("\u{e4}", 1, "a name holds only"),
    ];
    for (text, index, why) in table {
        let error = Pattern::new(text).expect_err(text).to_string();
        let start = format!("segment {index} of the pattern is neither `*` nor `**`, and {why}");
        assert!(error.starts_with(&start), "{text:?}: {error}");
    }
    let long = "a".repeat(256);
    assert_eq!(Pattern::new(&long), Err(PatternError::TooLong(256)));
    assert_eq!(pattern(&long[1..]).as_str(), &long[1..]);
}

//= SM2-GWC-001 test
#[test]
fn ids_are_lower_case_hexadecimal() {
    let mut bytes = [0xa5; 32];
    bytes[0] = 0x0f;
    bytes[31] = 0xf0;
    let text = format!("0f{}f0", "a5".repeat(30));
    assert_eq!(GatewayId(bytes).to_string(), text);
    assert_eq!(text.parse(), Ok(GatewayId(bytes)));
    let table = [
        (text[1..].into(), GatewayIdError::Length(63)),
        (text.clone() + "0", GatewayIdError::Length(65)),
        (text.to_uppercase(), GatewayIdError::BadByte(1)),
        (text.replace("f0", "fg"), GatewayIdError::BadByte(63)),
        (text.replace("0f", "/f"), GatewayIdError::BadByte(0)),
    ];
    for (text, expected) in table {
        assert_eq!(text.parse::<GatewayId>(), Err(expected), "{text}");
    }
}

fn rule(action: Action, names: &str) -> Rule {
    Rule {
        action,
        kind: None,
        names: pattern(names),
        direction: None,
        peers: None,
    }
}

fn decision(action: Action, rule: usize) -> Decision {
    let rule = Some(rule);
    Decision { action, rule }
}

const NO: Decision = Decision {
    action: Action::Deny,
    rule: None,
};

//= SM2-GWR-002 test
#[test]
fn the_first_rule_that_fits_decides() {
    let [first, second] = PEERS;
    let rules = Rules(vec![
        Rule {
            kind: Some(SubjectKind::Service),
            ..rule(Action::Allow, "arm/stop")
        },
        rule(Action::Deny, "arm/**"),
        Rule {
            direction: Some(Direction::Out),
            peers: Some(vec![second]),
            ..rule(Action::Allow, "**")
        },
    ]);
    let (topic, service) = (SubjectKind::Topic, SubjectKind::Service);
    let (inward, outward) = (Direction::In, Direction::Out);
    let table = [
        (
            service,
            "arm/stop",
            outward,
            first,
            decision(Action::Allow, 0),
        ),
        (
            topic,
            "arm/stop",
            outward,
            second,
            decision(Action::Deny, 1),
        ),
        (service, "arm", inward, first, decision(Action::Deny, 1)),
        (topic, "scan", outward, second, decision(Action::Allow, 2)),
        (topic, "scan", inward, second, NO),
        (topic, "scan", outward, first, NO),
    ];
    for (kind, called, direction, peer, expected) in table {
        let decided = rules.decide(kind, &name(called), direction, &peer);
        assert_eq!(decided, expected, "{kind:?} {called} {direction:?} {peer}");
        let allowed = rules.allow(kind, &name(called), direction, &peer);
        assert_eq!(allowed, expected.action == Action::Allow);
    }
    let nothing = Rules::default();
    assert_eq!(nothing.decide(topic, &name("a"), outward, &first), NO);
}

/// A denied name has one spelling. Every other spelling is either not a legal name, in a pattern and
/// in a frame alike, or the name of another subject.
//= SM2-GWR-001 test
//= SM2-GWR-002 test
//= SM2-NAM-001 test
#[test]
fn a_denied_name_has_no_other_spelling() {
    let denied = rule(Action::Deny, "secret/**");
    let rules = Rules(vec![denied, rule(Action::Allow, "**")]);
    let [peer, _] = PEERS;
    let allows = |text: &str| {
        let name = name(text);
        rules.allow(SubjectKind::Topic, &name, Direction::Out, &peer)
    };
    for text in ["secret", "secret/x", "secret/x/y", "secret/secret"] {
        assert!(!allows(text), "{text}");
    }
    for text in [
        "Secret/x",
        "SECRET/x",
        "secrets/x",
        "a/secret/x",
        "secret_/x",
    ] {
        assert!(allows(text), "{text} is another name");
    }
    let spellings = [
        "/secret/x",
        "secret//x",
        "secret/x/",
        "./secret/x",
        "a/../secret/x",
        "secret/./x",
        " secret/x",
        "secret/x ",
        "secret/x\0",
        "secret%2fx",
        "secret\\x",
        "secret\u{2215}x",
        "\u{ff53}ecret/x",
        "\u{455}ecret/x",
        "se\u{301}cret/x",
        "secret\u{200b}/x",
        "\u{202e}x/terces",
    ];
    for text in spellings {
        assert!(Name::new(text).is_err(), "{text:?}");
        assert!(Pattern::new(text).is_err(), "{text:?}");
        let standing_in = "n".repeat(text.len());
        let ask = Frame::Ask {
            ask: AskId(1),
            kind: SubjectKind::Topic,
            name: name(&standing_in),
        };
        let mut body = ask.to_bytes().split_off(4);
        let at = body.len() - text.len();
        assert_eq!(&body[at..], standing_in.as_bytes());
        assert_eq!(Frame::from_body(&body), Ok(ask));
        body[at..].copy_from_slice(text.as_bytes());
        assert_eq!(
            Frame::from_body(&body),
            Err(violation!(PeerViolationKind::BadName, "SM2-NAM-001")),
            "{text:?}"
        );
    }
}

/// All names of up to four of the segments `a`, `b` and `c`.
fn names() -> Vec<Name> {
    let mut texts: Vec<String> = vec![];
    let mut longest: Vec<String> = vec![String::new()];
    for _ in 0..4 {
        let next = |text: &String| ["a", "b", "c"].map(|it| format!("{text}/{it}"));
        longest = longest.iter().flat_map(next).collect();
        texts.extend(longest.iter().map(|it| it[1..].into()));
    }
    texts.iter().map(|it| name(it)).collect()
}

/// The oracle of patterns. For each part, it lists how many segments the parts up to there can match.
fn stands_for(pattern: &str, name: &Name) -> bool {
    let segments: Vec<&str> = name.as_str().split('/').collect();
    let mut taken = vec![0];
    for part in pattern.split('/') {
        taken = match part {
            "**" => (taken[0]..=segments.len()).collect(),
            part => {
                let is_next = |at: &&usize| {
                    segments
                        .get(**at)
                        .is_some_and(|it| part == "*" || *it == part)
                };
                taken.iter().filter(is_next).map(|at| at + 1).collect()
            }
        };
        if taken.is_empty() {
            return false;
        }
    }
    taken.contains(&segments.len())
}

fn texts() -> impl Strategy<Value = String> {
    let segments = vec(select(&["a", "b", "c", "*", "**"][..]), 1..6);
    segments.prop_map(|it| it.join("/"))
}

fn any_rule() -> impl Strategy<Value = Rule> {
    let kinds = [None, Some(SubjectKind::Topic), Some(SubjectKind::Service)];
    let directions = [None, Some(Direction::In), Some(Direction::Out)];
    let peers = [
        None,
        Some(vec![]),
        Some(vec![PEERS[0]]),
        Some(PEERS.to_vec()),
    ];
    let action = select(vec![Action::Allow, Action::Deny]);
    (
        action,
        select(kinds.to_vec()),
        texts(),
        select(directions.to_vec()),
        select(peers.to_vec()),
    )
        .prop_map(|(action, kind, text, direction, peers)| Rule {
            action,
            kind,
            names: pattern(&text),
            direction,
            peers,
        })
}

proptest! {
    #![proptest_config(cases(200))]

    //= SM2-GWR-001 test
    #[test]
    fn patterns_fit_what_they_stand_for(text in texts()) {
        let pattern = pattern(&text);
        for name in names() {
            prop_assert_eq!(pattern.fits(&name), stands_for(&text, &name), "{} {}", text, name);
        }
    }

    //= SM2-GWR-002 test
    #[test]
    fn rules_decide_as_the_list_of_them_says(rules in vec(any_rule(), 0..5), at in any::<prop::sample::Index>()) {
        let names = names();
        let name = at.get(&names);
        let list = rules.clone();
        let rules = Rules(rules);
        for kind in [SubjectKind::Topic, SubjectKind::Service] {
            for direction in [Direction::In, Direction::Out] {
                for peer in PEERS {
                    let mut expected = NO;
                    for (index, rule) in list.iter().enumerate().rev() {
                        let is_peer = match &rule.peers {
                            None => true,
                            Some(peers) => peers.contains(&peer),
                        };
                        if is_peer
                            && [None, Some(kind)].contains(&rule.kind)
                            && [None, Some(direction)].contains(&rule.direction)
                            && stands_for(rule.names.as_str(), name)
                        {
                            expected = decision(rule.action, index);
                        }
                    }
                    prop_assert_eq!(rules.decide(kind, name, direction, &peer), expected);
                }
            }
        }
    }
}
