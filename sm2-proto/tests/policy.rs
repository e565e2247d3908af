//! Access rights, compared with an oracle that applies each definition directly.

// Shows ACC-DECIDE (proptest), bound: cases of each clause; sampled policies and subjects.

mod naive;

use crate::support::{cases, contracts::name};
use proptest::prelude::*;
use sm2_proto::{
    gateway::Pattern,
    limits::{POLICY_TABLES_MAX, POLICY_TERMS_MAX},
    policy::{
        AccessPolicy, Action, ActionSet, Binding, Decision, Effect, Exclusive, Members,
        PolicyError, Rule, RuleId, Subject, Tables, User,
    },
};

fn patterns(texts: &[&str]) -> Vec<Pattern> {
    texts.iter().map(|it| Pattern::new(it).unwrap()).collect()
}

/// A rule that allows all actions under these names for every subject that is not remote.
fn rule(called: &str, names: &[&str]) -> Rule {
    Rule {
        name: name(called),
        effect: Effect::Allow,
        actions: ActionSet::ALL,
        names: patterns(names),
        members: Members::default(),
        nodes: None,
        peers: None,
    }
}

fn tables(rules: Vec<Rule>) -> Tables {
    Tables {
        default: Effect::Deny,
        rules,
        bindings: Vec::new(),
        exclusive: Vec::new(),
    }
}

fn policy(rules: Vec<Rule>) -> AccessPolicy {
    AccessPolicy::new(tables(rules)).unwrap()
}

fn user(uid: u32, gids: &[u32]) -> User {
    User {
        uid,
        gids: gids.to_vec(),
    }
}

fn subject(uid: u32, node: &str) -> Subject {
    Subject::new(user(uid, &[100]), name(node))
}

/// Whether a policy of this one rule allows `uid`, with group 100, to publish `scan` as `node`.
fn allows(rule: Rule, uid: u32, node: &str) -> bool {
    let decision = policy(vec![rule]).decide(&subject(uid, node), Action::Publish, &name("scan"));
    decision.effect == Effect::Allow
}

type Ids<'a> = Option<&'a [u32]>;

fn with_members(users: Ids<'_>, groups: Ids<'_>) -> Members {
    Members {
        users: users.map(<[u32]>::to_vec),
        groups: groups.map(<[u32]>::to_vec),
    }
}

//= SM2-ACC-001 test
#[test]
fn the_first_matching_rule_decides() {
    let denied = Rule {
        effect: Effect::Deny,
        ..rule("no-scan", &["scan"])
    };
    let both = policy(vec![denied.clone(), rule("all", &["**"])]);
    let me = subject(1, "talker");
    let decide = |policy: &AccessPolicy, called| {
        let Decision { effect, rule } = policy.decide(&me, Action::Publish, &name(called));
        (effect, rule)
    };
    assert_eq!(
        decide(&both, "scan"),
        (Effect::Deny, Some(RuleId(0))),
        "two rules match"
    );
    assert_eq!(decide(&both, "imu"), (Effect::Allow, Some(RuleId(1))));
    assert_eq!(both.rule_name(RuleId(1)), Some(&name("all")));
    assert_eq!(both.rule_name(RuleId(2)), None);
    for default in [Effect::Allow, Effect::Deny] {
        let tables = Tables {
            default,
            ..tables(vec![denied.clone()])
        };
        let policy = AccessPolicy::new(tables).unwrap();
        assert_eq!(decide(&policy, "imu"), (default, None));
    }
}

//= SM2-ACC-002 test
#[test]
fn a_rule_matches_if_all_its_conditions_do() {
    let base = || rule("it", &["imu", "*/x", "scan"]);
    assert!(allows(base(), 1, "talker"));
    assert!(!allows(rule("it", &["imu"]), 1, "talker"), "no pattern");
    assert!(!allows(rule("it", &[]), 1, "talker"), "without patterns");
    let others = Action::ALL.into_iter().filter(|it| *it != Action::Publish);
    let other_actions = Rule {
        actions: others.collect(),
        ..base()
    };
    assert!(!allows(other_actions, 1, "talker"));
    let table: [(Ids<'_>, Ids<'_>, bool); 8] = [
        (Some(&[2, 1]), None, true),
        (Some(&[2]), None, false),
        (Some(&[]), None, false),
        (None, Some(&[7, 100]), true),
        (None, Some(&[7]), false),
        (Some(&[1]), Some(&[100]), true),
        (Some(&[1]), Some(&[7]), false),
        (Some(&[2]), Some(&[100]), false),
    ];
    for (users, groups, expected) in table {
        let members = with_members(users, groups);
        let text = format!("{members:?}");
        let rule = Rule { members, ..base() };
        assert_eq!(allows(rule, 1, "talker"), expected, "{text}");
    }
    let nodes: [(&[&str], bool); 3] = [(&["x"], false), (&["x", "*"], true), (&[], false)];
    for (nodes, expected) in nodes {
        let rule = Rule {
            nodes: Some(patterns(nodes)),
            ..base()
        };
        assert_eq!(allows(rule, 1, "talker"), expected, "{nodes:?}");
    }
}

//= SM2-ACC-003 test
#[test]
fn a_remote_node_has_the_rights_of_its_peer() {
    let base = || rule("it", &["scan"]);
    let of_peer = || Rule {
        peers: Some(patterns(&["arm/*", "base"])),
        ..base()
    };
    let table = [
        (base(), "remote/base", true),
        (of_peer(), "remote/base", true),
        (of_peer(), "remote/arm/left", true),
        (of_peer(), "remote/arm", false),
        (of_peer(), "base", false),
        (of_peer(), "remote", false),
        (of_peer(), "remotes/base", false),
        (of_peer(), "x/remote/base", false),
    ];
    for (rule, node, expected) in table {
        let text = format!("{rule:?} {node}");
        assert_eq!(allows(rule, 1, node), expected, "{text}");
    }
    // The rights of the gateway's user are not those of its peers.
    let conditions = [
        Rule {
            members: with_members(Some(&[1]), None),
            ..base()
        },
        Rule {
            members: with_members(None, Some(&[100])),
            ..base()
        },
        Rule {
            nodes: Some(patterns(&["**"])),
            ..base()
        },
    ];
    for rule in conditions {
        assert!(!allows(rule.clone(), 1, "remote/base"), "{rule:?}");
        assert!(allows(rule.clone(), 1, "base"), "{rule:?}");
        let with_peer = Rule {
            peers: Some(patterns(&["base"])),
            ..rule
        };
        assert!(allows(with_peer.clone(), 1, "remote/base"));
        // A rule with both conditions is about the peer at this user.
        let has_members = !with_peer.members.is_all();
        let stranger = Subject::new(user(2, &[7]), name("remote/base"));
        let decision = policy(vec![with_peer]).decide(&stranger, Action::See, &name("scan"));
        assert_eq!(decision.effect == Effect::Deny, has_members);
    }
}

//= SM2-ACC-004 test
#[test]
fn a_binding_reserves_names_of_nodes() {
    let binding = |called, nodes, users, groups| Binding {
        name: name(called),
        nodes: patterns(nodes),
        members: with_members(users, groups),
    };
    let policy = AccessPolicy::new(Tables {
        bindings: vec![
            binding("guest", &["arm/guest"], None, None),
            binding("arm", &["arm/**", "remote/*"], Some(&[1, 2]), Some(&[100])),
            binding("nobody", &["root"], Some(&[]), None),
        ],
        ..tables(Vec::new())
    })
    .unwrap();
    let against = |uid, gid, node| {
        let binding = policy.binding_against(&user(uid, &[5, gid]), &name(node));
        binding.map(|it| it.name.to_string())
    };
    let arm = Some("arm".to_owned());
    assert_eq!(against(1, 100, "arm/left"), None);
    assert_eq!(against(2, 100, "remote/base"), None);
    assert_eq!(against(3, 100, "arm/left"), arm);
    assert_eq!(against(1, 101, "arm/left"), arm, "not in the group");
    assert_eq!(against(3, 101, "remote/base"), arm);
    assert_eq!(against(3, 101, "arm/guest"), None, "the first decides");
    assert_eq!(against(3, 101, "leg"), None, "free");
    assert_eq!(against(1, 100, "root"), Some("nobody".to_owned()));
}

//= SM2-ACC-005 test
#[test]
fn the_first_exclusive_entry_is_cited() {
    let entry = |called, topics| Exclusive {
        name: name(called),
        topics: patterns(topics),
    };
    let policy = AccessPolicy::new(Tables {
        exclusive: vec![
            entry("motion", &["cmd_vel", "*/cmd"]),
            entry("rest", &["a/**"]),
        ],
        ..tables(Vec::new())
    })
    .unwrap();
    let cited = |topic| policy.exclusive(&name(topic)).map(|it| it.name.to_string());
    assert_eq!(cited("cmd_vel").as_deref(), Some("motion"));
    assert_eq!(cited("a/cmd").as_deref(), Some("motion"));
    assert_eq!(cited("a/b").as_deref(), Some("rest"));
    assert_eq!(cited("scan"), None);
}

//= SM2-ACC-006 test
#[test]
fn a_policy_has_limits() {
    let full = |rules: usize| {
        let rules = (0..rules).map(|it| rule(&format!("rule-{it}"), &["**"]));
        let binding = Binding {
            name: name("binding"),
            nodes: patterns(&["a"]),
            members: Members::default(),
        };
        let exclusive = Exclusive {
            name: name("exclusive"),
            topics: patterns(&["a"]),
        };
        AccessPolicy::new(Tables {
            bindings: vec![binding],
            exclusive: vec![exclusive],
            ..tables(rules.collect())
        })
    };
    assert!(full(POLICY_TABLES_MAX - 2).is_ok());
    assert_eq!(
        full(POLICY_TABLES_MAX - 1),
        Err(PolicyError::TooManyTables(POLICY_TABLES_MAX + 1))
    );
}

//= SM2-ACC-006 test
#[test]
fn every_pattern_user_and_group_counts() {
    let empty = Rule {
        nodes: Some(Vec::new()),
        peers: Some(Vec::new()),
        members: with_members(Some(&[]), Some(&[])),
        ..rule("full", &[])
    };
    let binding = Binding {
        name: name("binding"),
        nodes: Vec::new(),
        members: with_members(Some(&[]), Some(&[])),
    };
    let exclusive = Exclusive {
        name: name("exclusive"),
        topics: Vec::new(),
    };
    // Fills one list of the tables.
    let filled = |place: usize, count: usize| {
        let (many, ids) = (vec![Pattern::new("a").unwrap(); count], vec![1; count]);
        let (mut rule, mut binding, mut exclusive) =
            (empty.clone(), binding.clone(), exclusive.clone());
        match place {
            0 => rule.names = many,
            1 => rule.nodes = Some(many),
            2 => rule.peers = Some(many),
            3 => rule.members.users = Some(ids),
            4 => rule.members.groups = Some(ids),
            5 => binding.nodes = many,
            6 => binding.members.users = Some(ids),
            7 => binding.members.groups = Some(ids),
            _ => exclusive.topics = many,
        }
        AccessPolicy::new(Tables {
            bindings: vec![binding],
            exclusive: vec![exclusive],
            ..tables(vec![rule])
        })
    };
    for place in 0..9 {
        assert!(filled(place, POLICY_TERMS_MAX).is_ok(), "{place}");
        let error = PolicyError::TooManyTerms(POLICY_TERMS_MAX + 1);
        assert_eq!(filled(place, POLICY_TERMS_MAX + 1), Err(error), "{place}");
    }
}

//= SM2-ACC-006 test
#[test]
fn each_name_cites_one_entry() {
    let duplicate = Err(PolicyError::DuplicateName(name("a")));
    let rules = tables(vec![rule("a", &["x"]), rule("a", &["y"])]);
    assert_eq!(AccessPolicy::new(rules), duplicate);
    let binding = Binding {
        name: name("a"),
        nodes: Vec::new(),
        members: Members::default(),
    };
    let mixed = Tables {
        bindings: vec![binding],
        ..tables(vec![rule("a", &["x"])])
    };
    assert_eq!(AccessPolicy::new(mixed), duplicate);
    let exclusive = Exclusive {
        name: name("a"),
        topics: Vec::new(),
    };
    let mixed = Tables {
        exclusive: vec![exclusive],
        ..tables(vec![rule("a", &["x"])])
    };
    assert_eq!(AccessPolicy::new(mixed), duplicate);
}

//= SM2-ACC-007 test
#[test]
fn without_a_policy_everything_is_allowed() {
    let none = AccessPolicy::default();
    for node in ["talker", "remote/base"] {
        let me = subject(1, node);
        for action in Action::ALL {
            let decision = none.decide(&me, action, &name("scan"));
            assert_eq!(decision.effect, Effect::Allow);
            assert_eq!(decision.rule, None);
        }
        assert_eq!(none.binding_against(me.user(), me.node()), None);
    }
    assert_eq!(none.exclusive(&name("cmd_vel")), None);
}

proptest! {
    #![proptest_config(cases(4_096))]

    /// `PROPTEST_CASES=1000000` runs as many policies.
    //= SM2-ACC-001 test
    //= SM2-ACC-002 test
    //= SM2-ACC-003 test
    //= SM2-ACC-004 test
    //= SM2-ACC-005 test
    #[test]
    fn random_policies_decide_as_the_oracle(
        lines in naive::policy(),
        questions in proptest::collection::vec(naive::question(), 1..8),
    ) {
        let policy = lines.build();
        for question in questions {
            let subject = question.subject();
            let decision = policy.decide(&subject, question.action, &name(&question.name));
            let (allowed, rule) = lines.decide(&question);
            prop_assert_eq!(decision.effect == Effect::Allow, allowed);
            prop_assert_eq!(decision.rule, rule.map(RuleId));
            let binding = policy.binding_against(subject.user(), subject.node());
            let binding = binding.map(|it| it.name.to_string());
            prop_assert_eq!(binding, lines.binding_against(&question));
            let exclusive = policy.exclusive(&name(&question.name));
            let exclusive = exclusive.map(|it| it.name.to_string());
            prop_assert_eq!(exclusive, lines.exclusive(&question.name));
        }
    }
}
