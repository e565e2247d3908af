//! The start and the end of a Manager: the claim of its socket, signals, crashes, unusable paths.

use std::{
    fs::{self, Permissions},
    os::unix::{fs::PermissionsExt, net::UnixListener, process::CommandExt},
};

use nix::{sys::signal::Signal, unistd::geteuid};
use sm2_io::SeqPacket;
use sm2_proto::Farewell;
use sm2_tests::{
    control::{self, Qos},
    domain::{ManagerProcess, TempDomain},
    process::{Exit, Process, actor},
    raw::{RawLink, RawNode},
};

/// Two nodes of the domain and the link between them.
fn linked(manager: &ManagerProcess) -> ([RawNode; 2], [RawLink; 2]) {
    let nodes = [manager.node("talker"), manager.node("listener")];
    nodes[0].declare(1, &control::publisher("t", Qos::PLAIN));
    nodes[1].declare(1, &control::subscriber("t", Qos::PLAIN));
    let ends = [nodes[0].linked(), nodes[1].linked()];
    (nodes, ends)
}

#[track_caller]
fn talk(ends: &[RawLink; 2]) {
    ends[0].end.send(b"still here");
    assert_eq!(ends[1].end.expect().bytes, b"still here");
    ends[1].end.send(b"so am I");
    assert_eq!(ends[0].end.expect().bytes, b"so am I");
}

//= SM2-SES-008, SM2-TRN-007 sys
#[test]
fn a_signal_ends_a_manager_in_order() {
    for signal in [Signal::SIGTERM, Signal::SIGINT] {
        let domain = TempDomain::new();
        let mut manager = domain.manager();
        assert_eq!(domain.files(), ["domain.sock", "domain.sock.lock"]);
        let (nodes, ends) = linked(&manager);
        let silent = manager.connect();
        manager.signal(signal);
        for node in &nodes {
            // GOODBYE, without UNLINK before it.
            assert_eq!(node.ended(), Some(Farewell::ShuttingDown.code()));
        }
        silent.ended();
        assert_eq!(manager.wait(), Exit::Status(0), "{}", manager.log());
        assert!(domain.files().is_empty(), "left: {:?}", domain.files());
        talk(&ends);
    }
}

//= SM2-NOD-003, SM2-SES-007, SM2-TRN-007 sys
#[test]
fn a_manager_that_was_killed_is_replaced_and_its_links_live() {
    let domain = TempDomain::new();
    let mut epochs = Vec::new();
    let mut links = Vec::new();
    for _ in 0..3 {
        let mut manager = domain.manager();
        let (nodes, ends) = linked(&manager);
        epochs.push(ends[0].id.epoch);
        manager.kill();
        for node in &nodes {
            assert_eq!(node.ended(), None, "nobody was there to say goodbye");
        }
        assert_eq!(domain.files(), ["domain.sock", "domain.sock.lock"]);
        let refused = SeqPacket::connect(&domain.socket()).map(drop);
        let refused = refused.expect_err("nobody listens").kind();
        assert_eq!(refused, std::io::ErrorKind::ConnectionRefused);
        links.push(ends);
        links.iter().for_each(talk);
    }
    epochs.sort_unstable();
    epochs.dedup();
    assert_eq!(epochs.len(), 3, "no epoch is used twice");
}

//= SM2-TRN-007 sys
#[test]
fn a_second_manager_is_refused_and_the_first_one_serves_on() {
    let domain = TempDomain::new();
    let first = domain.manager();
    let before = fs::metadata(domain.socket()).expect("the socket");
    let (_nodes, ends) = linked(&first);
    for _ in 0..3 {
        let mut second = domain.manager_start(&[]);
        assert_eq!(second.wait(), Exit::Status(1));
        second.log_says("another Manager serves");
        assert!(
            second.log().contains(&*domain.socket().to_string_lossy()),
            "the error names the place: {}",
            second.log()
        );
    }
    let after = fs::metadata(domain.socket()).expect("the socket");
    use std::os::unix::fs::MetadataExt;
    assert_eq!(before.ino(), after.ino(), "the socket is the first one's");
    assert_eq!(first.node("third").nodes(), ["talker", "listener", "third"]);
    talk(&ends);
}

//= SM2-TRN-007 sys
#[test]
fn of_managers_that_start_at_once_one_serves() {
    let domain = TempDomain::new();
    let mut all: Vec<_> = (0..6).map(|_| domain.manager_start(&[])).collect();
    let mut lost = 0;
    sm2_tests::eventually("five Managers to give up", || {
        lost = all
            .iter_mut()
            .map(|manager| usize::from(manager.has_ended()))
            .sum();
        lost == 5
    });
    let winner = all.iter_mut().find_map(|m| (!m.has_ended()).then_some(m));
    let winner = winner.expect("one that serves");
    winner.log_says("serving");
    assert_eq!(winner.node("only").nodes(), ["only"]);
}

//= SM2-TRN-007 sys
#[test]
fn a_socket_that_a_dead_manager_left_is_replaced() {
    let domain = TempDomain::new();
    drop(UnixListener::bind(domain.socket()).expect("a stale socket"));
    assert_eq!(domain.files(), ["domain.sock"]);
    let manager = domain.manager();
    assert_eq!(manager.node("n").nodes(), ["n"]);
}

#[test]
fn a_bad_place_is_refused_with_what_to_do() {
    let exists = TempDomain::new();
    fs::write(exists.socket(), "precious").expect("a file");
    fails(&exists, "is not a socket: remove it");
    assert_eq!(fs::read(exists.socket()).expect("the file"), b"precious");

    let open = TempDomain::new();
    fs::set_permissions(open.folder(), Permissions::from_mode(0o777)).expect("chmod");
    fails(&open, "chmod o-w");

    let deep = TempDomain::new();
    let mut command = actor("manager");
    let path = deep.folder().join("no/such/folder/domain.sock");
    command.arg("--socket").arg(&path);
    let mut manager = Process::start(command);
    assert_eq!(manager.wait(), Exit::Status(1));
    manager.stderr_says("cannot create directory");

    let mut long = actor("manager");
    long.arg("--socket")
        .arg(deep.folder().join("x".repeat(107)));
    let mut manager = Process::start(long);
    assert_eq!(manager.wait(), Exit::Status(1));
    manager.stderr_says("something shorter");
}

#[track_caller]
fn fails(domain: &TempDomain, advice: &str) {
    let mut manager = domain.manager_start(&[]);
    assert_eq!(manager.wait(), Exit::Status(1), "{}", manager.log());
    manager.log_says(advice);
}

//= SM2-TRN-001, SM2-TRN-002 sys
#[test]
fn the_domain_decides_where_the_socket_is() {
    let home = TempDomain::new();
    let runtime = home.folder().join("run");
    fs::create_dir(&runtime).expect("a folder");
    let explicit = home.folder().join("explicit.sock");
    let cases = [
        (None, None, None, "sm2/default.sock"),
        (None, None, Some("robot-1"), "sm2/robot-1.sock"),
        (Some("robot_2"), None, Some("robot-1"), "sm2/robot_2.sock"),
        (None, Some(&explicit), Some("robot-1"), "../explicit.sock"),
        (Some("robot_2"), Some(&explicit), None, "sm2/robot_2.sock"),
    ];
    for (named, socket, variable, expected) in cases {
        let mut command = actor("manager");
        command.env("XDG_RUNTIME_DIR", &runtime);
        if let Some(domain) = named {
            command.args(["--domain", domain]);
        }
        if let Some(path) = socket {
            command.env("SM2_SOCKET", path);
        }
        if let Some(domain) = variable {
            command.env("SM2_DOMAIN", domain);
        }
        let manager = Process::start(command);
        manager.stderr_says("serving");
        let node = RawNode::welcomed(&runtime.join(expected), "n");
        assert_eq!(node.nodes(), ["n"], "{expected}");
    }
    for bad in ["", "a/b", "..", "a b", &"x".repeat(65)] {
        let mut command = actor("manager");
        command.env("XDG_RUNTIME_DIR", &runtime);
        command.args(["--domain", bad]);
        let mut manager = Process::start(command);
        assert_eq!(manager.wait(), Exit::Status(1), "domain {bad:?}");
        manager.stderr_says("use 1 to 64 letters");
    }
}

#[test]
fn two_domains_do_not_see_each_other() {
    let (one, two) = (TempDomain::new(), TempDomain::new());
    let managers = [one.manager(), two.manager()];
    let talker = managers[0].node("same-name");
    let listener = managers[1].node("same-name");
    assert_eq!(talker.declare(1, &control::publisher("t", Qos::PLAIN)), 0);
    assert_eq!(
        listener.declare(1, &control::subscriber("t", Qos::PLAIN)),
        0
    );
    assert_eq!(talker.nodes(), ["same-name"]);
    assert_eq!(
        listener.query().len(),
        3,
        "the domain, a node, its interface"
    );
    assert!(talker.peer().is_quiet() && listener.peer().is_quiet());
}

#[test]
fn who_may_connect_is_said_by_the_sockets_permissions() {
    if !geteuid().is_root() {
        sm2_test_support::skip("only root can become somebody else");
        return;
    }
    let domain = TempDomain::new();
    let folder = Permissions::from_mode(0o711);
    fs::set_permissions(domain.folder(), folder).expect("chmod");
    for (mode, allowed) in [("600", false), ("666", true)] {
        let _manager = domain.manager_with(&["--socket-mode", mode]);
        let mut stranger = actor("connect");
        stranger.arg("--socket").arg(domain.socket());
        stranger.uid(65_534).gid(65_534);
        let answer = Process::start(stranger).expect_line();
        let expected = if allowed {
            "connected"
        } else {
            "permission denied"
        };
        assert_eq!(answer, expected, "mode {mode}");
    }
}
