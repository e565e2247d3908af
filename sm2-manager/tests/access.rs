//! The access policy of a domain: where a Manager finds it, and what it does without it.

// Shows ACC-ENFORCE (test), bound: cases, with real processes.

use crate::common;
use std::{
    fs::{self, Permissions},
    os::unix::{
        fs::{PermissionsExt, chown, symlink},
        process::CommandExt,
    },
    path::PathBuf,
};

use crate::common::{Program, TestDomain};
use nix::{sys::signal::Signal, unistd::geteuid};
use sm2_manager::{Background, Options, StartError};
use sm2_node::{ConnectError, DeclareError, Node};
use sm2_proto::{Name, Refusal};

/// Everybody may do everything but publish `secret`.
const POLICY: &str = "\
default = \"allow\"

[[rule]]
name = \"no-secret\"
effect = \"deny\"
actions = [\"publish\"]
names = [\"secret\"]

[[binding]]
name = \"nobody\"
nodes = [\"root\"]
users = [4294967295]

[[exclusive]]
name = \"motion\"
topics = [\"cmd_vel\"]
";

fn policy(domain: &TestDomain, name: &str, text: &str) -> PathBuf {
    let path = domain.folder().join(name);
    fs::write(&path, text).unwrap();
    fs::set_permissions(&path, Permissions::from_mode(0o644)).unwrap();
    path
}

fn connect(domain: &TestDomain, name: &str) -> Result<Node, ConnectError> {
    let builder = Node::builder(name).socket(domain.socket());
    builder.manager_timeout(common::SOON).connect()
}

fn denied(rule: &str) -> Refusal {
    Refusal::Denied {
        rule: Some(Name::new(rule).unwrap()),
    }
}

/// Whether the Manager of this domain applies [`POLICY`].
fn is_restricted(domain: &TestDomain) -> bool {
    let node = connect(domain, "talker").unwrap();
    match node.publisher::<[u8]>("secret") {
        Ok(_) => false,
        Err(DeclareError::Refused { reason, .. }) => {
            assert_eq!(reason, denied("no-secret"));
            true
        }
        Err(error) => panic!("{error}"),
    }
}

//= SM2-ACC-012, SM2-ACC-008, SM2-ACC-009 sys
#[test]
fn the_file_beside_the_socket_is_the_policy() {
    let domain = TestDomain::new();
    let mut manager = domain.manager(&[]);
    assert!(!is_restricted(&domain), "without a policy");
    manager.kill();
    manager.wait();
    policy(&domain, "domain.sock.policy", POLICY);
    let _manager = domain.manager(&[]);
    assert!(is_restricted(&domain));
    match connect(&domain, "root") {
        Err(ConnectError::Refused(reason)) => assert_eq!(reason, denied("nobody")),
        other => panic!("{:?}", other.map(drop)),
    }
    let (one, other) = (connect(&domain, "one"), connect(&domain, "other"));
    let (one, other) = (one.unwrap(), other.unwrap());
    let first = one.publisher::<[u8]>("cmd_vel").unwrap();
    let error = other.publisher::<[u8]>("cmd_vel").err().unwrap();
    assert!(error.to_string().contains("`motion`"), "{error}");
    drop(first);
    common::eventually("the topic is free", || {
        drop(one.spin_once_timeout(std::time::Duration::ZERO));
        other.publisher::<[u8]>("cmd_vel").is_ok()
    });
}

/// `--policy` makes a file the policy of the domain, also of the Managers after this one.
//= SM2-ACC-012 sys
#[test]
fn the_policy_of_the_command_line_stays_with_the_domain() {
    let domain = TestDomain::new();
    let file = policy(&domain, "robot.toml", POLICY);
    let mut manager = domain.manager(&["--policy", file.to_str().unwrap()]);
    assert!(is_restricted(&domain));
    let link = domain.folder().join("domain.sock.policy");
    assert_eq!(
        fs::canonicalize(&link).unwrap(),
        fs::canonicalize(&file).unwrap()
    );
    manager.signal(Signal::SIGTERM);
    assert_eq!(manager.wait(), Some(0));
    let embedded = Background::start(&domain.socket(), Options::default()).unwrap();
    assert!(is_restricted(&domain));
    embedded.stop().unwrap();
    assert_eq!(domain.files(), ["domain.sock.policy", "robot.toml"]);
}

/// A policy that is broken, not there any more, or that others can write.
fn spoil(domain: &TestDomain, how: &str) {
    let link = domain.folder().join("domain.sock.policy");
    match how {
        "broken" => drop(policy(domain, "domain.sock.policy", "default = \"all\"")),
        "gone" => symlink(domain.folder().join("nothing"), &link).unwrap(),
        _ => {
            // The owner and mode of a file are checked before its text.
            let text = if how == "writable" { POLICY } else { "default" };
            policy(domain, "domain.sock.policy", text);
            fs::set_permissions(&link, Permissions::from_mode(0o666)).unwrap();
        }
    }
}

//= SM2-ACC-012 sys
#[test]
fn a_manager_without_its_policy_does_not_serve() {
    for (how, why) in [
        ("broken", "domain.sock.policy:1: unknown variant `all`"),
        ("gone", "No such file"),
        ("writable", "the mode 666"),
        ("writable and broken", "the mode 666"),
    ] {
        let domain = TestDomain::new();
        spoil(&domain, how);
        for option in [&[][..], &["--standby"], &["--replace"]] {
            let (status, text) = domain.fails(option);
            assert_eq!(status, Some(1), "{how} {option:?}: {text}");
            assert!(text.contains(why), "{how} {option:?}: {text}");
        }
        let embedded = Background::start_or_stand_by(&domain.socket(), Options::default());
        assert!(
            matches!(embedded, Err(StartError::Policy(_))),
            "{embedded:?}"
        );
        // The domain is free for a Manager with a policy. A policy that is not a link is not replaced.
        let good = policy(&domain, "good.toml", POLICY);
        if how != "gone" {
            let (status, text) = domain.fails(&["--policy", good.to_str().unwrap()]);
            assert_eq!(status, Some(1), "{how}: {text}");
            assert!(text.contains("a file of its own"), "{how}: {text}");
            fs::remove_file(domain.folder().join("domain.sock.policy")).unwrap();
        }
        let _manager = domain.manager(&["--policy", good.to_str().unwrap()]);
        assert!(is_restricted(&domain));
    }
}

/// A standby in a program cannot take over from a Manager whose policy it cannot read.
//= SM2-ACC-012 sys
#[test]
fn a_standby_does_not_take_over_without_the_policy() {
    let domain = TestDomain::new();
    let file = policy(&domain, "robot.toml", POLICY);
    let mut manager = domain.manager(&["--policy", file.to_str().unwrap()]);
    let standby: Program = domain.standby();
    fs::write(&file, "default = \"all\"").unwrap();
    manager.kill();
    manager.wait();
    standby.says("cannot take over yet");
    standby.says("unknown variant `all`");
    assert!(connect_once(&domain).is_err(), "nobody serves");
    fs::write(&file, POLICY).unwrap();
    standby.says("serving");
    assert!(is_restricted(&domain));
}

fn connect_once(domain: &TestDomain) -> std::io::Result<sm2_io::SeqPacket> {
    sm2_io::SeqPacket::connect(&domain.socket())
}

/// Otherwise the domain would be without a Manager for as long as the policy is broken.
//= SM2-ACC-012, SM2-RES-009 sys
#[test]
fn a_manager_without_its_policy_replaces_nobody() {
    let domain = TestDomain::new();
    let file = policy(&domain, "robot.toml", POLICY);
    let active = domain.manager(&["--policy", file.to_str().unwrap()]);
    fs::write(&file, "default = \"all\"").unwrap();
    let (status, text) = domain.fails(&["--replace"]);
    assert_eq!(status, Some(1), "{text}");
    assert!(text.contains("unknown variant `all`"), "{text}");
    assert_eq!(domain.client("node").server(), active.pid());
    let said = active.stderr();
    assert!(!said.contains("handing over"), "{said}");
}

/// A Manager trusts the files of its own user and those of root.
//= SM2-ACC-012 sys
#[test]
fn a_policy_of_a_third_user_is_not_used() {
    if !geteuid().is_root() {
        return sm2_test_support::skip("only root can give a file to another user");
    }
    let domain = TestDomain::new();
    let file = policy(&domain, "domain.sock.policy", POLICY);
    for (owner, is_trusted) in [(0, true), (65_534, true), (65_533, false)] {
        chown(&file, Some(owner), None).unwrap();
        let mut command = domain.for_a_stranger(&["--socket-mode", "666"]);
        chown(domain.folder(), Some(65_534), None).unwrap();
        command.uid(65_534).gid(65_534);
        let mut manager = Program::start(command);
        match is_trusted {
            true => {
                manager.says("serving");
                assert!(is_restricted(&domain), "{owner}");
                manager.signal(Signal::SIGTERM);
                assert_eq!(manager.wait(), Some(0), "{owner}");
            }
            false => {
                assert_eq!(manager.wait(), Some(1));
                manager.says("65533");
            }
        }
    }
}
