//! A Manager under attack by half-open connections, floods, and nodes that do not read. It serves
//! nodes that obey SPEC all the time.

use std::{
    io::IoSlice,
    os::fd::{AsFd, OwnedFd},
    sync::atomic::{AtomicBool, Ordering::Relaxed},
    thread,
};

use sm2_io::{SendError, SeqPacket};
use sm2_proto::{
    Farewell, Quota, Refusal, ViolationKind,
    control::{Limit, Limits, ToNode},
};
use sm2_tests::{
    control::{self, Qos},
    domain::{ManagerProcess, TempDomain},
    eventually, memory,
    process::{Process, actor},
    raw::RawNode,
};

//= SM2-SES-004 sys
#[test]
fn whoever_does_not_greet_is_ended_and_a_silent_node_is_not() {
    let domain = TempDomain::new();
    let manager = domain.manager_with(&["--greeting-ms", "1000"]);
    let (honest, welcome) = greeted(&manager, "honest");
    assert_eq!(welcome[0], 0, "WELCOME");
    honest.nodes();
    let baseline = manager.census_when_idle();
    let silent: Vec<RawNode> = (0..20).map(|_| manager.connect()).collect();
    // A connection that was refused does not become ready.
    let (refused, answer) = greeted(&manager, "honest");
    assert_eq!(answer, [1, 0], "HELLO_REFUSED");
    for node in silent.iter().chain([&refused]) {
        assert_eq!(node.ended(), Some(Farewell::GreetingTimeout.code()));
    }
    // All of them have timed out, although this node was silent for as long.
    assert_eq!(honest.nodes(), ["honest"]);
    baseline.restored(manager.pid());
}

/// A node that has greeted in time, and the answer. A machine that is too slow for that makes it try again.
fn greeted(manager: &ManagerProcess, name: &str) -> (RawNode, Vec<u8>) {
    let mut greeted = None;
    eventually("a greeting in time", || {
        let node = manager.connect();
        // The Manager may have ended the connection already.
        let _: Result<(), SendError> = node.peer().try_send(&control::hello(name), &[]);
        let answer = node.peer().expect().bytes;
        let is_late = answer == control::to_node::goodbye(Farewell::GreetingTimeout.code().0);
        greeted = (!is_late).then_some((node, answer));
        !is_late
    });
    greeted.expect("until now")
}

/// Eight times as many connections that do not greet as one process may have. The surplus is refused with a
/// reason, connected nodes are served, and other processes can connect.
//= SM2-SES-010 sys
#[test]
fn a_flood_of_connections_ends_at_the_limit() {
    let domain = TempDomain::new();
    let manager = domain.manager_with(&["--greeting-ms", "600000"]);
    let honest = manager.node("honest");
    honest.nodes();
    let baseline = manager.census_when_idle();
    let limit = Limits::default().count(Limit::GreetingsPerProcess);
    let flood: Vec<RawNode> = (0..8 * limit).map(|_| manager.connect()).collect();
    let (within, beyond) = flood.split_at(limit);
    for node in beyond {
        assert_eq!(node.ended(), Some(Farewell::Resources.code()));
    }
    assert!(within.iter().all(|node| node.peer().is_quiet()));
    assert_eq!(honest.nodes(), ["honest"], "served during the flood");
    let late = manager.connect();
    assert_eq!(late.ended(), Some(Farewell::Resources.code()));
    // The log has a few lines for all of them.
    let lines = manager.log().matches("hung up").count();
    assert!(lines <= 32, "{lines} lines");
    // Another process is not affected.
    let other = another_process(&domain, "other");
    assert_eq!(honest.nodes(), ["honest", "other"]);
    drop(other);
    eventually("the other node's end", || honest.nodes() == ["honest"]);
    // A connection that greets makes room for another one.
    within[0].greet("within");
    manager.node("honest-too").close();
    drop(flood);
    eventually("the end of the flood", || honest.nodes() == ["honest"]);
    manager.node("honest-again").close();
    baseline.restored(manager.pid());
}

/// A process that opens all sessions that it may have, and stays silent.
//= SM2-SES-010 sys
#[test]
fn a_process_with_all_its_sessions_locks_nobody_out() {
    let domain = TempDomain::new();
    let manager = domain.manager_with(&["--sessions-per-user", "8", "--sessions-per-process", "5"]);
    let silent: Vec<RawNode> = (0..5).map(|it| manager.node(&format!("n{it}"))).collect();
    let refused = manager.connect();
    refused.send(control::hello("n5"));
    let reason = Refusal::Quota {
        quota: Quota::SessionsPerProcess,
        limit: 5,
    };
    assert_eq!(refused.next(), ToNode::HelloRefused { reason });
    let _others: Vec<Process> = ["a", "b", "c"]
        .map(|it| another_process(&domain, it))
        .into();
    assert_eq!(silent[0].nodes().len(), 8);
}

/// A node in a process of its own.
fn another_process(domain: &TempDomain, name: &str) -> Process {
    let mut command = actor("connect");
    command.arg("--socket").arg(domain.socket());
    command.args(["--name", name]);
    let process = Process::start(command);
    assert_eq!(process.expect_line(), "welcome");
    process
}

//= SM2-TRN-010 sys
#[test]
fn a_flood_of_descriptors_leaves_none_behind() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let honest = manager.node("honest");
    honest.nodes();
    let baseline = manager.census_when_idle();
    let nulls: Vec<OwnedFd> = (0..253).map(|_| memory::null()).collect();
    let nulls: Vec<_> = nulls.iter().map(AsFd::as_fd).collect();
    for round in 0..200 {
        let node = manager.connect();
        // Several at once: connections that are queued behind a violation are closed, too.
        for _ in 0..3 {
            match node.peer().try_send(&control::hello("flood"), &nulls) {
                Ok(()) | Err(SendError::Closed | SendError::WouldBlock) => {}
                Err(error) => panic!("round {round}: {error}"),
            }
        }
        assert_eq!(node.ended(), Some(ViolationKind::FdCount.code()));
    }
    assert_eq!(honest.nodes(), ["honest"]);
    baseline.restored(manager.pid());
}

//= SM2-TRN-008 sys
#[test]
fn a_node_that_does_not_read_is_given_up_and_nobody_waits_for_it() {
    // With the default, which is eight times as long, the test takes eight times as long.
    let options: &[&str] = match cfg!(feature = "slow") {
        true => &[],
        false => &["--queue-bytes", "131072"],
    };
    let domain = TempDomain::new();
    let manager = domain.manager_with(options);
    let honest = manager.node("honest");
    // Makes each page longer.
    for interface in 1..=40 {
        let topic = format!("{}/{interface}", "long".repeat(50));
        honest.declare(interface, &control::publisher(topic, Qos::PLAIN));
    }
    honest.nodes();
    let baseline = manager.census_when_idle();
    let deaf = manager.node("deaf");
    let mut queries = 0;
    eventually("the Manager to give up", || {
        match deaf.peer().try_send(&control::query(), &[]) {
            Ok(()) => queries += 1,
            Err(SendError::WouldBlock) => {}
            Err(SendError::Closed) => return true,
            Err(error) => panic!("after {queries} queries: {error}"),
        }
        assert_eq!(honest.nodes()[0], "honest");
        false
    });
    manager.log_says("stalled");
    // The frames in the socket are still there, then the end of the stream: GOODBYE did not fit.
    let mut pages = 0;
    while deaf.peer().next_frame().is_some() {
        pages += 1;
    }
    assert!(pages < queries, "{pages} pages for {queries} queries");
    assert_eq!(honest.nodes(), ["honest"], "the deaf node is gone");
    baseline.restored(manager.pid());
}

/// The bytes that wait for a node that does not read are as many as the option says: the same answers fit into
/// the default, and not into an eighth of it.
//= SM2-TRN-008 sys
#[test]
fn the_queue_of_a_node_is_as_long_as_its_option_says() {
    const QUERIES: usize = 60;
    for (options, fits) in [(&[][..], true), (&["--queue-bytes", "131072"], false)] {
        let domain = TempDomain::new();
        let manager = domain.manager_with(options);
        let honest = manager.node("honest");
        // A page of about 10 kB: 60 of them exceed the buffer of the socket by some 400 kB.
        for interface in 1..=40 {
            let topic = format!("{}/{interface}", "long".repeat(50));
            honest.declare(interface, &control::publisher(topic, Qos::PLAIN));
        }
        let deaf = manager.node("deaf");
        for _ in 0..QUERIES {
            // A node that was given up cannot send any more.
            let _ = deaf.peer().try_send(&control::query(), &[]);
        }
        if !fits {
            manager.log_says("stalled");
        }
        let pages = std::iter::from_fn(|| deaf.peer().next_frame())
            .take(QUERIES)
            .count();
        assert_eq!(pages == QUERIES, fits, "{pages} pages with {options:?}");
    }
}

/// Hundreds of nodes connect, execute some steps and crash, while one node works.
#[test]
fn nodes_that_come_and_go_in_disorder_leave_nothing() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let honest = manager.node("honest");
    honest.nodes();
    let baseline = manager.census_when_idle();
    for round in 0..300_u32 {
        let node = manager.connect();
        let steps = [
            control::hello("churn"),
            control::declare(1, &control::publisher("c", Qos::PLAIN)),
            control::declare(2, &control::subscriber("c", Qos::RELIABLE)),
            control::declare(3, &control::subscriber("c", Qos::PLAIN)),
            control::withdraw(1),
            control::query(),
            control::goodbye(0),
        ];
        // Each node ends after another number of steps, without reading an answer.
        for step in &steps[..(round as usize % (steps.len() + 1))] {
            node.send(step);
        }
        drop(node);
        assert_eq!(honest.nodes()[0], "honest");
    }
    eventually("all of them gone", || honest.nodes() == ["honest"]);
    baseline.restored(manager.pid());
}

/// Nodes that send legal requests without pause are served in turn with all others.
#[test]
fn a_flood_of_legal_frames_keeps_nobody_from_being_served() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let honest = manager.node("honest");
    let served = AtomicBool::new(false);
    thread::scope(|scope| {
        for flooder in ["flood-1", "flood-2", "flood-3"] {
            let node = manager.node(flooder);
            let served = &served;
            scope.spawn(move || {
                for interface in 1.. {
                    if served.load(Relaxed) {
                        return;
                    }
                    let contract = control::publisher("t", Qos::PLAIN);
                    let frames = [
                        control::declare(interface, &contract),
                        control::query(),
                        control::withdraw(interface),
                    ];
                    for frame in frames {
                        node.send(frame);
                    }
                    // Reads the answers, so that the Manager does not give the node up.
                    (0..3).for_each(|_| drop(node.next()));
                }
            });
        }
        for interface in 1..=200 {
            honest.declare(interface, &control::publisher("u", Qos::PLAIN));
            assert_eq!(honest.nodes()[0], "honest");
        }
        served.store(true, Relaxed);
    });
    eventually("the floods to end", || honest.nodes() == ["honest"]);
}

/// Sockets sent over sockets, including one sent over itself. The kernel has to collect the cycle,
/// and the Manager closes the descriptors.
//= SM2-TRN-010 sys
#[test]
fn sockets_that_carry_sockets_leave_nothing_behind() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let honest = manager.node("honest");
    honest.nodes();
    let baseline = manager.census_when_idle();
    for _ in 0..50 {
        let node = manager.connect();
        let (mut outer, inner) = SeqPacket::pair().expect("sockets");
        drop(inner);
        for _ in 0..20 {
            let (one, other) = SeqPacket::pair().expect("sockets");
            let parts = [IoSlice::new(b"nested")];
            one.send(&parts, &[outer.as_fd(), one.as_fd()])
                .expect("sent");
            outer = other;
        }
        let own = node.peer().socket().as_fd();
        node.send_fds(control::hello("nested"), &[outer.as_fd(), own]);
        assert_eq!(node.ended(), Some(ViolationKind::FdCount.code()));
    }
    assert_eq!(honest.nodes(), ["honest"]);
    baseline.restored(manager.pid());
}
