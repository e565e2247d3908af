//! Sessions and links in the control plane: raw nodes against a real Manager.

// Shows MGR-IDS, MGR-RELEASE, MGR-QUOTA, CLI-DROPPING, LNK-FAREWELL (test, full).

use std::os::{fd::AsFd, fd::AsRawFd};

use nix::sys::socket::{MsgFlags, send};
use sm2_proto::{
    Code, Farewell, NodeId,
    control::{Item, ToNode},
};
use sm2_tests::{
    control::{self, Qos},
    domain::{ManagerProcess, TempDomain},
    eventually,
    process::{Process, actor},
    raw::RawNode,
};

//= SM2-SES-003 sys
#[test]
fn a_name_belongs_to_one_ready_session() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let first = manager.node("arm/left");
    let second = manager.connect();
    for _ in 0..3 {
        second.send(control::hello("arm/left"));
        assert_eq!(
            second.peer().expect().bytes,
            [1, 0],
            "HELLO_REFUSED name-taken"
        );
    }
    second.greet("arm/right");
    assert_eq!(first.nodes(), ["arm/left", "arm/right"]);
    first.send(control::goodbye(0));
    assert!(
        first.peer().next_frame().is_none(),
        "GOODBYE is not answered"
    );
    assert_eq!(manager.node("arm/left").nodes(), ["arm/right", "arm/left"]);
}

//= SM2-SES-001 sys
#[test]
fn frames_may_follow_hello_without_waiting_for_welcome() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let node = manager.connect();
    node.send(control::hello("arm/left"));
    node.send(control::declare(1, &control::publisher("pose", Qos::PLAIN)));
    node.send(control::query());
    assert!(matches!(node.next(), ToNode::Welcome { .. }));
    assert!(matches!(node.next(), ToNode::Declared { matches: 0, .. }));
    assert!(matches!(node.next(), ToNode::Page(_)));
    // After a refused HELLO, the same frame arrives before WELCOME.
    let second = manager.connect();
    second.send(control::hello("arm/left"));
    second.send(control::query());
    assert!(matches!(second.next(), ToNode::HelloRefused { .. }));
    assert_eq!(second.ended(), Some(Code(32)), "expected-hello");
}

/// The kernel closes the sockets of a killed process before its parent is told. From then on the
/// name is free, without any wait.
//= SM2-SES-003, SM2-SES-006 sys
#[test]
fn the_name_of_a_process_that_crashed_is_free_at_once() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    for round in 0..30 {
        let mut command = actor("connect");
        command.arg("--socket").arg(domain.socket());
        command.args(["--name", "crasher"]);
        let mut process = Process::start(command);
        assert_eq!(process.expect_line(), "welcome");
        process.kill();
        let heir = manager.connect();
        heir.send(control::hello("crasher"));
        let answer = heir.next();
        assert!(
            matches!(answer, ToNode::Welcome { .. }),
            "round {round}: {answer:?}"
        );
    }
}

/// The same when the Manager sees both events at once, and the new node had sent its HELLO before
/// the other one crashed.
//= SM2-SES-003 sys
#[test]
fn whoever_crashed_is_gone_before_newcomers_are_heard() {
    let domain = TempDomain::new();
    let mut manager = domain.manager();
    let observer = manager.node("observer");
    let mut command = actor("connect");
    command.arg("--socket").arg(domain.socket());
    command.args(["--name", "crasher"]);
    let mut process = Process::start(command);
    assert_eq!(process.expect_line(), "welcome");
    let heir = manager.connect();
    // The Manager has answered this query, so it has accepted the connection.
    observer.nodes();
    manager.stop();
    heir.send(control::hello("observer"));
    process.kill();
    heir.send(control::hello("crasher"));
    manager.resume();
    assert_eq!(heir.peer().expect().bytes, [1, 0], "HELLO_REFUSED");
    let answer = heir.next();
    assert!(matches!(answer, ToNode::Welcome { .. }), "{answer:?}");
}

//= SM2-TRN-006 sys
#[test]
fn who_a_node_is_comes_from_the_kernel() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let mut command = actor("connect");
    command.arg("--socket").arg(domain.socket());
    command.args(["--name", "somebody"]);
    let process = Process::start(command);
    assert_eq!(process.expect_line(), "welcome");
    let items = manager.node("observer").query();
    let known = items.iter().find_map(|item| match item {
        Item::Node { name, uid, pid, .. } if name.as_str() == "somebody" => Some((*uid, *pid)),
        _ => None,
    });
    let expected = (nix::unistd::geteuid().as_raw(), process.pid().cast_signed());
    assert_eq!(known, Some(expected));
}

//= SM2-SES-007 sys
#[test]
fn no_number_is_given_to_two_sessions() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let mut last = 0;
    for _ in 0..50 {
        let (node, _) = manager.connect().greet("again-and-again");
        assert!(node > last, "{node} after {last}");
        last = node;
        eventually("its end", || manager_forgot(&manager));
    }
}

fn manager_forgot(manager: &ManagerProcess) -> bool {
    manager.node("observer").nodes() == ["observer"]
}

//= SM2-TRN-005 sys
#[test]
fn what_was_sent_before_the_end_counts() {
    let domain = TempDomain::new();
    let mut manager = domain.manager();
    let listener = manager.node("listener");
    listener.declare(1, &control::subscriber("t", Qos::PLAIN));
    for _ in 0..20 {
        let talker = manager.connect();
        talker.send(control::hello("talker"));
        talker.peer().readable();
        manager.stop();
        talker.send(control::declare(1, &control::publisher("t", Qos::PLAIN)));
        // Closed while WELCOME is unread: the Manager's socket reports ECONNRESET before the
        // datagrams that are still queued.
        talker.close();
        manager.resume();
        let link = listener.linked();
        assert_eq!(link.peer.name.as_str(), "talker");
        assert_eq!(listener.unlinked(link.id), Farewell::PeerGone.code());
        listener.send(control::unlinked(1, link.id, 0));
    }
}

//= SM2-TRN-003 sys
#[test]
fn an_empty_datagram_is_the_end() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let honest = manager.node("honest");
    let node = manager.node("empty");
    let socket = node.peer().socket().as_fd().as_raw_fd();
    send(socket, &[], MsgFlags::empty()).expect("an empty datagram");
    assert!(node.peer().next_frame().is_none(), "ended without a word");
    assert_eq!(honest.nodes(), ["honest"]);
}

//= SM2-LNK-001 sys
#[test]
fn a_manager_keeps_no_end_of_a_link() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let (talker, listener) = (manager.node("talker"), manager.node("listener"));
    listener.declare(1, &control::subscriber("t", Qos::PLAIN));
    let baseline = manager.census_when_idle();
    let mut links = Vec::new();
    for interface in 1..=50 {
        talker.declare(interface, &control::publisher("t", Qos::PLAIN));
        links.push((talker.linked(), listener.linked()));
    }
    baseline.restored(manager.pid());
    for (ours, theirs) in &links {
        assert_eq!(ours.id, theirs.id);
        ours.end.send(b"to");
        theirs.end.send(b"fro");
        assert_eq!(theirs.end.expect().bytes, b"to");
        assert_eq!(ours.end.expect().bytes, b"fro");
    }
    for (ours, theirs) in links {
        // No other process holds the ends: closing one end closes the other.
        ours.end.close();
        assert!(theirs.end.next_frame().is_none());
    }
}

//= SM2-LNK-002 sys
#[test]
fn a_links_number_is_never_used_again() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let node = manager.node("n");
    node.declare(1, &control::subscriber("t", Qos::PLAIN));
    let mut last = 0;
    for interface in 2..40 {
        node.declare(interface, &control::publisher("t", Qos::PLAIN));
        let ends = [node.linked(), node.linked()];
        assert!(ends.iter().all(|end| end.id.serial > last));
        last = ends[0].id.serial;
        node.send(control::withdraw(interface));
        assert_eq!(node.unlinked(ends[0].id), Code(0));
        assert_eq!(
            node.peer().expect().bytes,
            [6, interface as u8],
            "WITHDRAWN"
        );
        node.send(control::unlinked(1, ends[0].id, 0));
    }
}

/// Both sides of a link close it, one after the other and at the same time.
//= SM2-LNK-003, SM2-LNK-009 sys
#[test]
fn each_end_of_a_link_has_one_farewell_in_each_direction() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let (talker, listener) = (manager.node("talker"), manager.node("listener"));
    listener.declare(1, &control::subscriber("t", Qos::PLAIN));
    for interface in 1..=20 {
        talker.declare(interface, &control::publisher("t", Qos::PLAIN));
        let (ours, theirs) = (talker.linked(), listener.linked());
        // The node is first: it gets its answer, and the other side is told.
        talker.send(control::unlinked(interface, ours.id, 71));
        if interface % 2 == 0 {
            // This UNLINKED crosses the Manager's UNLINK.
            listener.send(control::unlinked(1, theirs.id, 72));
        }
        talker.unlinked(ours.id);
        listener.unlinked(theirs.id);
        if interface % 2 == 1 {
            listener.send(control::unlinked(1, theirs.id, 0));
        }
        // The pair is not linked again, and both sessions continue.
        assert_eq!(talker.nodes(), ["talker", "listener"]);
        assert_eq!(listener.nodes(), ["talker", "listener"]);
        assert!(talker.peer().is_quiet() && listener.peer().is_quiet());
    }
}

//= SM2-IFC-004 sys
#[test]
fn a_link_that_crosses_a_withdrawal_is_nobodys_fault() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let (talker, listener) = (manager.node("talker"), manager.node("listener"));
    listener.declare(1, &control::subscriber("t", Qos::PLAIN));
    talker.declare(1, &control::publisher("t", Qos::PLAIN));
    let (ours, _theirs) = (talker.linked(), listener.linked());
    // Ends the link and drops the interface before the Manager's answer is read.
    listener.send(control::withdraw(1));
    talker.send(control::unlinked(1, ours.id, 0));
    talker.unlinked(ours.id);
    assert_eq!(talker.nodes(), ["talker", "listener"]);
    let withdrawn = [6, 1];
    let mut answer = listener.peer().expect().bytes;
    if answer != withdrawn {
        // The talker's UNLINKED arrived first, so this is UNLINK, which needs no answer.
        assert_eq!(answer[..2], [5, 1], "UNLINK");
        answer = listener.peer().expect().bytes;
    }
    assert_eq!(answer, withdrawn, "WITHDRAWN");
    assert_eq!(listener.nodes(), ["talker", "listener"]);
}

//= SM2-SES-006 sys
#[test]
fn all_links_of_a_node_end_with_it() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let listener = manager.node("listener");
    for interface in 1..=10 {
        listener.declare(interface, &control::subscriber("t", Qos::PLAIN));
    }
    let talker = manager.node("talker");
    talker.declare(1, &control::publisher("t", Qos::PLAIN));
    let links: Vec<_> = (0..10).map(|_| listener.linked()).collect();
    talker.close();
    for link in &links {
        assert_eq!(listener.unlinked(link.id), Farewell::PeerGone.code());
        listener.send(control::unlinked(link.interface, link.id, 5));
    }
    let left = listener.query();
    let of_talker =
        |item: &Item| matches!(item, Item::Interface { entity, .. } if entity.node != NodeId(1));
    assert!(!left.iter().any(of_talker), "{left:?}");
}

//= SM2-IFC-006 sys
#[test]
fn what_exceeds_a_quota_is_refused_and_the_session_goes_on() {
    let domain = TempDomain::new();
    let manager = domain.manager_with(&[
        "--sessions-per-user",
        "3",
        "--interfaces-per-session",
        "2",
        "--links-per-session",
        "1",
    ]);
    let (a, b, _c) = (manager.node("a"), manager.node("b"), manager.node("c"));
    let fourth = manager.connect();
    fourth.send(control::hello("d"));
    // One process has all sessions of the user: its quota is used up first, and is the same.
    assert_refused(&fourth, 4, 3);
    a.declare(1, &control::publisher("t", Qos::PLAIN));
    b.declare(1, &control::subscriber("t", Qos::PLAIN));
    b.send(control::declare(2, &control::subscriber("t", Qos::PLAIN)));
    // The other side's quota is used up: the interface is granted but not linked.
    let _links = (a.linked(), b.linked());
    let answer = b.next();
    assert!(
        matches!(answer, ToNode::Declared { matches: 0, .. }),
        "{answer:?}"
    );
    b.send(control::declare(3, &control::subscriber("u", Qos::PLAIN)));
    assert_refused(&b, 1, 2);
    assert_eq!(b.nodes(), ["a", "b", "c"]);
}

/// HELLO_REFUSED or DECLARE_REFUSED with this quota and this limit.
#[track_caller]
fn assert_refused(node: &RawNode, quota: u8, limit: u8) {
    let bytes = node.peer().expect().bytes;
    assert!(bytes.ends_with(&[4, quota, limit]), "{bytes:?}");
}
