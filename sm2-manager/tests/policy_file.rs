//! Policy files: the policy that a text means, and the errors and warnings about it.

use std::{fs, path::Path};

use nix::unistd::{User, getuid};
use sm2_manager::{PolicyFile, PolicyFileError};
use sm2_proto::{
    Name,
    gateway::Pattern,
    limits::POLICY_FILE_MAX,
    policy::{
        Action, ActionSet, Binding, Effect, Exclusive, Members, Rule, RuleId, Subject, Tables,
    },
};

const COMPLETE: &str = "\
# Access rights of the arm
default = \"deny\"

[[rule]]
name = \"arm\"
effect = \"allow\"
actions = [\"publish\", \"read-counters\"]
names = [\"arm/**\", \"cmd_vel\"]
users = [7, 8]
groups = [9]
nodes = [\"arm/*\"]
peers = [\"base\"]

[[rule]]
effect = \"deny\"
names = [\"**\"]

[[binding]]
nodes = [\"arm/*\", \"remote/**\"]
users = [7]

[[exclusive]]
name = \"motion\"
topics = [\"cmd_vel\"]
";

fn name(text: &str) -> Name {
    Name::new(text).unwrap()
}

fn patterns(texts: &[&str]) -> Vec<Pattern> {
    texts.iter().map(|it| Pattern::new(it).unwrap()).collect()
}

fn parse(text: &str) -> Result<PolicyFile, PolicyFileError> {
    PolicyFile::parse(Path::new("policy.toml"), text)
}

fn error(text: &str) -> String {
    match parse(text) {
        Ok(file) => panic!("{text}\nis a policy: {file:?}"),
        Err(error) => error.to_string(),
    }
}

#[test]
fn a_file_is_the_policy_that_it_states() {
    let file = parse(COMPLETE).unwrap();
    let members = |users: &[u32], groups: Option<Vec<u32>>| Members {
        users: Some(users.to_vec()),
        groups,
    };
    let arm = Rule {
        name: name("arm"),
        effect: Effect::Allow,
        actions: [Action::Publish, Action::ReadCounters]
            .into_iter()
            .collect(),
        names: patterns(&["arm/**", "cmd_vel"]),
        members: members(&[7, 8], Some(vec![9])),
        nodes: Some(patterns(&["arm/*"])),
        peers: Some(patterns(&["base"])),
    };
    let rest = Rule {
        name: name("rule-2"),
        effect: Effect::Deny,
        actions: ActionSet::ALL,
        names: patterns(&["**"]),
        members: Members::default(),
        nodes: None,
        peers: None,
    };
    let expected = Tables {
        default: Effect::Deny,
        rules: vec![arm, rest],
        bindings: vec![Binding {
            name: name("binding-1"),
            nodes: patterns(&["arm/*", "remote/**"]),
            members: members(&[7], None),
        }],
        exclusive: vec![Exclusive {
            name: name("motion"),
            topics: patterns(&["cmd_vel"]),
        }],
    };
    assert_eq!(*file.policy.tables(), expected);
    let lines = [
        ("arm", 4),
        ("rule-2", 14),
        ("binding-1", 18),
        ("motion", 22),
    ];
    for (table, line) in lines {
        assert_eq!(file.line_of(&name(table)), Some(line), "{table}");
    }
    assert_eq!(file.line_of(&name("rule-1")), None);
    assert_eq!(file.rule_line(RuleId(1)), Some(14));
    assert_eq!(file.rule_line(RuleId(2)), None);
}

#[test]
fn each_action_has_a_word() {
    for action in Action::ALL {
        let text = format!(
            "default = \"deny\"\n[[rule]]\neffect = \"allow\"\nactions = [\"{action}\"]\nnames = [\"**\"]\n"
        );
        let policy = parse(&text).unwrap().policy;
        let user = sm2_proto::policy::User {
            uid: 1,
            gids: Vec::new(),
        };
        let subject = Subject::new(user, name("talker"));
        for other in Action::ALL {
            let effect = policy.decide(&subject, other, &name("scan")).effect;
            assert_eq!(effect == Effect::Allow, other == action, "{action} {other}");
        }
    }
}

#[test]
fn names_of_users_and_groups_are_looked_up() {
    let me = User::from_uid(getuid()).unwrap().unwrap();
    let text = format!(
        "default = \"allow\"\n[[rule]]\neffect = \"deny\"\nnames = [\"a\"]\nusers = [\"{}\"]\ngroups = [\"root\"]\n",
        me.name
    );
    let file = parse(&text).unwrap();
    let members = &file.policy.tables().rules[0].members;
    assert_eq!(members.users, Some(vec![getuid().as_raw()]));
    assert_eq!(members.groups, Some(vec![0]));
}

/// A text with a fault, the start of its error, and a part of it.
type Fault<'a> = (String, &'a str, &'a str);

fn rule(more: &str) -> String {
    format!("default = \"deny\"\n[[rule]]\neffect = \"allow\"\n{more}\n")
}

fn names(more: &str) -> String {
    rule(&format!("names = [\"a\"]\n{more}"))
}

fn check_errors(faults: &[Fault<'_>]) {
    for (text, start, part) in faults {
        let error = error(text);
        assert!(error.starts_with(start), "{text}\n{error}");
        assert!(error.contains(part), "{text}\n{error}");
    }
}

#[test]
fn errors_of_keys_name_the_line() {
    check_errors(&[
        ("".to_owned(), "policy.toml:1: ", "missing field `default`"),
        (
            "default = \"maybe\"".to_owned(),
            "policy.toml:1: ",
            "unknown variant `maybe`",
        ),
        (
            "default = \"deny\"\n\nrules = 1".to_owned(),
            "policy.toml:3: ",
            "unknown field `rules`",
        ),
        (
            "default = \"deny\"\n[[rule]".to_owned(),
            "policy.toml:2: ",
            "",
        ),
        (rule(""), "policy.toml:2: ", "missing field `names`"),
        (
            names("user = [1]"),
            "policy.toml:5: ",
            "unknown field `user`",
        ),
        (
            names("actions = [\"see\", \"write\"]"),
            "policy.toml:5: ",
            "actions: `write`: an action is publish, subscribe, serve",
        ),
        (
            names("users = [-1]"),
            "policy.toml:5: ",
            "an id from 0 to 4294967295",
        ),
    ]);
}

#[test]
fn errors_of_values_name_the_line_and_the_key() {
    check_errors(&[
        (
            names("actions = []"),
            "policy.toml:5: actions: ",
            "an empty list matches nothing",
        ),
        (
            rule("names = []"),
            "policy.toml:4: names: ",
            "an empty list matches nothing",
        ),
        (
            names("users = []"),
            "policy.toml:5: users: ",
            "an empty list matches nothing",
        ),
        (
            names("groups = []"),
            "policy.toml:5: groups: ",
            "an empty list matches nothing",
        ),
        (
            names("nodes = []"),
            "policy.toml:5: nodes: ",
            "an empty list matches nothing",
        ),
        (
            names("peers = [\n\"a\",\n\"b*\"]"),
            "policy.toml:7: peers: `b*`: ",
            "segment 1",
        ),
        (
            names("name = \"a b\""),
            "policy.toml:5: name: `a b`: ",
            "not ' '",
        ),
        (
            names("peers = [\"b\u{e4}r\"]"),
            "policy.toml:5: peers: `b\u{e4}r`: ",
            "not '\u{e4}'",
        ),
        (
            names("users = [\"no such user\"]"),
            "policy.toml:5: users: ",
            "no user `no such user`",
        ),
        (
            names("groups = [1, \"no such one\"]"),
            "policy.toml:5: groups: ",
            "no group `no such one`",
        ),
        (
            names("[[exclusive]]\nname = \"rule-1\"\ntopics = [\"a\"]"),
            "policy.toml:5: ",
            "have the name `rule-1`: rename one",
        ),
        (
            "default = \"deny\"\n[[binding]]\nnodes = []".to_owned(),
            "policy.toml:3: nodes: ",
            "an empty list",
        ),
        (
            "default = \"deny\"\n[[exclusive]]\ntopics = [\"\"]".to_owned(),
            "policy.toml:3: topics: ",
            "segment 1",
        ),
    ]);
}

//= SM2-ACC-006 test
#[test]
fn a_file_above_the_limits_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("policy.toml");
    let start = "default = \"deny\"\n#";
    let filled = |len: u64| {
        let rest = usize::try_from(len).unwrap() - start.len();
        fs::write(&path, format!("{start}{}", "x".repeat(rest))).unwrap();
        PolicyFile::load(&path)
    };
    assert!(filled(POLICY_FILE_MAX).is_ok());
    let refused = filled(POLICY_FILE_MAX + 1);
    assert!(
        matches!(refused, Err(PolicyFileError::TooLong { .. })),
        "{refused:?}"
    );
    let many = "[[exclusive]]\ntopics = [\"a\"]\n".repeat(1_025);
    let error = error(&format!("default = \"deny\"\n{many}"));
    assert!(error.starts_with("policy.toml:2050: "), "{error}");
    assert!(error.contains("this one has 1025"), "{error}");
}

#[test]
fn a_path_without_a_policy_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let missing = PolicyFile::load(&folder.path().join("policy.toml"));
    assert!(
        matches!(missing, Err(PolicyFileError::Io { .. })),
        "{missing:?}"
    );
    let of_folder = PolicyFile::load(folder.path());
    assert!(matches!(of_folder, Err(PolicyFileError::NotAFile { .. })));
    let fifo = folder.path().join("fifo");
    nix::unistd::mkfifo(&fifo, nix::sys::stat::Mode::S_IRWXU).unwrap();
    assert!(matches!(
        PolicyFile::load(&fifo),
        Err(PolicyFileError::NotAFile { .. })
    ));
}

#[test]
fn a_rule_by_name_alone_is_warned_of() {
    let warnings = |text: &str| {
        let warnings = parse(&format!("default = \"deny\"\n{text}"))
            .unwrap()
            .warnings();
        let lines: Vec<_> = warnings.iter().map(ToString::to_string).collect();
        lines.join("\n")
    };
    let rule = |more: &str| format!("[[rule]]\neffect = \"allow\"\nnames = [\"a\"]\n{more}\n");
    let binding = |nodes: &str| format!("[[binding]]\nnodes = [\"{nodes}\"]\nusers = [7]\n");
    let by_node = rule("nodes = [\"arm\"]");
    let by_peer = rule("peers = [\"base\"]");
    let text = warnings(&by_node);
    assert!(
        text.contains("rule `rule-1` in line 2") && text.contains("`arm`"),
        "{text}"
    );
    let text = warnings(&by_peer);
    assert!(text.contains("`remote/base`"), "{text}");
    for covered in ["arm", "*", "**"] {
        assert_eq!(
            warnings(&format!("{by_node}{}", binding(covered))),
            "",
            "{covered}"
        );
    }
    assert_ne!(warnings(&format!("{by_node}{}", binding("arms"))), "");
    assert_eq!(warnings(&format!("{by_peer}{}", binding("remote/*"))), "");
    let free = "[[binding]]\nnodes = [\"arm\"]\n";
    assert_ne!(warnings(&format!("{by_node}{free}")), "", "binds to nobody");
    for harmless in ["", "nodes = [\"arm\"]\nusers = [7]", "nodes = [\"**\"]"] {
        assert_eq!(warnings(&rule(harmless)), "", "{harmless}");
    }
    assert_eq!(warnings(&by_node.replace("allow", "deny")), "");
    let all = "[[rule]]\neffect = \"deny\"\nnames = [\"**\"]\n";
    let text = warnings(&format!("{all}{by_node}"));
    assert_eq!(
        text,
        "rule `rule-2` in line 5 is never reached: rule `rule-1` matches everything"
    );
    let after = rule("users = [7]");
    for partial in [
        all.replace("**", "a/**"),
        format!("{all}actions = [\"publish\"]\n"),
        format!("{all}users = [7]\n"),
        format!("{all}groups = [7]\n"),
        format!("{all}nodes = [\"arm\"]\n"),
        format!("{all}peers = [\"base\"]\n"),
    ] {
        assert_eq!(warnings(&format!("{partial}{after}")), "", "{partial}");
    }
}
