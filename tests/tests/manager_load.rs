//! A Manager under attack by half-open connections, floods, and nodes that do not read. It serves
//! nodes that obey SPEC all the time.

use std::{
    io::IoSlice,
    os::fd::{AsFd, OwnedFd},
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, Ordering::Relaxed},
    },
    thread,
};

use nix::unistd::{Uid, geteuid};
use sm2_io::{SendError, SeqPacket};
use sm2_proto::{
    Farewell, Quota, Refusal, ViolationKind,
    control::{Item, Page, ToNode},
    manager::Policy,
};
use sm2_tests::{
    control::{self, Qos},
    domain::TempDomain,
    eventually, memory,
    process::{Process, actor},
    raw::RawNode,
};

//= SM2-SES-004 sys
#[test]
fn whoever_does_not_greet_is_ended_and_a_silent_node_is_not() {
    let domain = TempDomain::new();
    let manager = domain.manager_with(&["--greeting-timeout", "1"]);
    let honest = manager.node("honest");
    honest.nodes();
    let baseline = manager.census();
    let silent: Vec<RawNode> = (0..20).map(|_| manager.connect()).collect();
    // A connection that was refused does not become ready.
    let refused = manager.connect();
    refused.send(control::hello("honest"));
    assert_eq!(refused.peer().expect().bytes, [1, 0], "HELLO_REFUSED");
    for node in silent.iter().chain([&refused]) {
        assert_eq!(node.ended(), Some(Farewell::GreetingTimeout.code()));
    }
    // All of them have timed out, although this node was silent for as long.
    assert_eq!(honest.nodes(), ["honest"]);
    baseline.restored(manager.pid());
}

/// Eight times as many connections that do not greet as one process may have. The surplus is refused with a
/// reason, connected nodes are served, and other processes can connect.
//= SM2-SES-010 sys
#[test]
fn a_flood_of_connections_ends_at_the_limit() {
    let domain = TempDomain::new();
    let manager = domain.manager_with(&["--greeting-timeout", "600"]);
    let honest = manager.node("honest");
    honest.nodes();
    let baseline = manager.census();
    let limit = Policy::default().greetings_per_process;
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
    let manager = domain.manager_with(&["--max-sessions", "8", "--max-process-sessions", "5"]);
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

//= SM2-TRN-011 sys
#[test]
fn a_flood_of_descriptors_leaves_none_behind() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let honest = manager.node("honest");
    honest.nodes();
    let baseline = manager.census();
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

//= SM2-TRN-009 sys
#[test]
fn a_node_that_does_not_read_is_given_up_and_nobody_waits_for_it() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let honest = manager.node("honest");
    // Makes each page longer.
    for interface in 1..=40 {
        let topic = format!("{}/{interface}", "long".repeat(50));
        honest.declare(interface, &control::publisher(topic, Qos::PLAIN));
    }
    honest.nodes();
    let baseline = manager.census();
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
    while deaf.peer().recv().is_some() {
        pages += 1;
    }
    assert!(pages < queries, "{pages} pages for {queries} queries");
    assert_eq!(honest.nodes(), ["honest"], "the deaf node is gone");
    baseline.restored(manager.pid());
}

/// The bytes that wait for a node that does not read are as many as the option says: the same answers fit into
/// the default, and not into an eighth of it.
//= SM2-TRN-009 sys
#[test]
fn the_queue_of_a_node_is_as_long_as_its_option_says() {
    const QUERIES: usize = 60;
    for (options, fits) in [(&[][..], true), (&["--max-queue-bytes", "131072"], false)] {
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
        let pages = std::iter::from_fn(|| deaf.peer().recv())
            .take(QUERIES)
            .count();
        assert_eq!(pages == QUERIES, fits, "{pages} pages with {options:?}");
    }
}

/// Serializes tests that leave many descriptors in flight, since the kernel counts them per user.
static IN_FLIGHT: Mutex<()> = Mutex::new(());

/// The link ends that a deaf node does not read are descriptors of the Manager. Their number is
/// limited: further links wait until the node reads, and no other node is affected.
//= SM2-LNK-007, SM2-IFC-002, SM2-TRN-009 sys
#[test]
fn links_of_a_node_that_does_not_read_wait_and_nobody_else_does() {
    const LINKS: u64 = 1_023;
    let _alone = IN_FLIGHT.lock().unwrap_or_else(PoisonError::into_inner);
    let domain = TempDomain::new();
    let manager = domain.manager_with(&["--nofile", "400"]);
    let (honest, other) = (manager.node("honest"), manager.node("other"));
    let deaf = manager.node("deaf");
    deaf.declare(1, &control::subscriber("t", Qos::PLAIN));
    honest.nodes();
    let baseline = manager.census();
    let mut told = Vec::new();
    for interface in 1..=LINKS {
        match honest.declare(interface, &control::publisher("t", Qos::PLAIN)) {
            0 => {}
            1 => told.push(honest.linked().id),
            more => panic!("{more} links with one subscriber"),
        }
    }
    // Descriptors in flight are not open in the Manager, so its census counts only those that it keeps.
    let kept = manager.census().descriptors() - baseline.descriptors();
    let ahead = Policy::default().links_in_flight;
    assert!(
        0 < kept && kept <= ahead,
        "{kept} descriptors for a deaf node"
    );
    assert!(told.len() >= ahead && (told.len() as u64) < LINKS);
    assert_eq!(
        honest.declare(LINKS + 1, &control::subscriber("u", Qos::PLAIN)),
        0
    );
    assert_eq!(other.declare(1, &control::publisher("u", Qos::PLAIN)), 1);
    assert_eq!(other.linked().id, honest.linked().id, "others are linked");
    let late = manager.node("late");
    assert_eq!(late.declare(1, &control::subscriber("u", Qos::PLAIN)), 1);
    assert_eq!(late.linked().id, other.linked().id, "and whoever comes");
    // The node reads again.
    for link in &told {
        assert_eq!(deaf.linked().id, *link);
    }
    for _ in told.len() as u64..LINKS {
        assert_eq!(deaf.linked().id, honest.linked().id, "one that waited");
    }
    drop(late);
    baseline.restored(manager.pid());
}

/// The frames that are queued for a node that does not read can exceed the Manager's descriptors. Then
/// only this node is disconnected.
//= SM2-TRN-009, SM2-SES-006, SM2-LNK-009 sys
#[test]
fn a_node_that_does_not_take_its_links_does_not_use_up_the_descriptors() {
    let _alone = IN_FLIGHT.lock().unwrap_or_else(PoisonError::into_inner);
    let domain = TempDomain::new();
    let manager = domain.manager_with(&["--nofile", "128"]);
    let honest = manager.node("honest");
    honest.nodes();
    let baseline = manager.census();
    let deaf = manager.node("deaf");
    deaf.declare(1, &control::subscriber("t", Qos::PLAIN));
    let mut links = Vec::new();
    for interface in 1..=1024 {
        let contract = control::publisher("t", Qos::PLAIN);
        honest.send(control::declare(interface, &contract));
        match honest.next() {
            // Every link is made, although the other side does not read its end.
            ToNode::Declared { matches: 1, .. } => links.push(honest.linked()),
            // When the Manager gives the other side up: UNLINK for each link.
            ToNode::Unlink { .. } => break,
            other => panic!("{other:?}"),
        }
    }
    manager.log_says("stalled");
    assert!(links.len() > 128, "only {} links", links.len());
    eventually("the deaf node's end", || names_now(&honest) == ["honest"]);
    baseline.restored(manager.pid());
    let late = manager.node("late");
    late.declare(1, &control::subscriber("t", Qos::PLAIN));
    late.linked();
    drop(deaf);
}

/// The names on the first page, after any UNLINKs.
fn names_now(node: &RawNode) -> Vec<String> {
    node.send(control::query());
    loop {
        match node.next() {
            ToNode::Unlink { .. } | ToNode::Declared { .. } => {}
            ToNode::Page(Page { items, .. }) => {
                let names = items.into_iter().filter_map(|item| match item {
                    Item::Node { name, .. } => Some(name.as_str().to_owned()),
                    _ => None,
                });
                return names.collect();
            }
            other => panic!("{other:?}"),
        }
    }
}

/// Hundreds of nodes connect, execute some steps and crash, while one node works.
#[test]
fn nodes_that_come_and_go_in_disorder_leave_nothing() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let honest = manager.node("honest");
    honest.nodes();
    let baseline = manager.census();
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
//= SM2-TRN-011 sys
#[test]
fn sockets_that_carry_sockets_leave_nothing_behind() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let honest = manager.node("honest");
    honest.nodes();
    let baseline = manager.census();
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

/// A Manager without a free descriptor for a new connection serves its present ones, and accepts the
/// new one when a descriptor is free.
//= SM2-LNK-008 sys
#[test]
fn a_manager_that_runs_out_of_descriptors_recovers() {
    let domain = TempDomain::new();
    let manager = domain.manager_with(&["--nofile", "40"]);
    let honest = manager.node("honest");
    honest.nodes();
    let baseline = manager.census();
    let many: Vec<RawNode> = (0..60).map(|_| manager.connect()).collect();
    manager.log_says("cannot accept a connection");
    assert_eq!(honest.nodes(), ["honest"]);
    // A link needs two descriptors for a moment. Without them the pair is not linked for now.
    assert_eq!(honest.declare(1, &control::publisher("t", Qos::PLAIN)), 0);
    assert_eq!(honest.declare(2, &control::subscriber("t", Qos::PLAIN)), 1);
    // The answer to a query comes after any LINK would have.
    assert_eq!(honest.nodes(), ["honest"], "no LINK without a socket");
    drop(many);
    // The Manager tries again by itself.
    assert_eq!(honest.linked().id, honest.linked().id);
    eventually("a connection to be served", || honest.nodes() == ["honest"]);
    let late = manager.node("late");
    assert_eq!(late.declare(1, &control::subscriber("t", Qos::PLAIN)), 1);
    assert_eq!(late.linked().id, honest.linked().id);
    drop(late);
    eventually("the late node's end", || names_now(&honest) == ["honest"]);
    baseline.restored(manager.pid());
}

/// The kernel counts descriptors in flight for the user who sends them. Above the limit of open
/// files it refuses further ones from an unprivileged user (`ETOOMANYREFS`), even if their receiver
/// is not the one that does not read.
//= SM2-TRN-010 sys
#[test]
fn descriptors_in_flight_that_nobody_takes_cost_the_one_who_does_not() {
    if !geteuid().is_root() {
        println!("skipped: only root can start a Manager for a user without privileges");
        return;
    }
    let domain = TempDomain::new();
    // A separate user, for whom no other run of this test counts.
    let user = Uid::from_raw(100_000 + std::process::id());
    let manager = domain.manager_as(user, &["--nofile", "64"]);
    let (honest, other) = (manager.node("honest"), manager.node("other"));
    let deaf = manager.node("deaf");
    deaf.declare(1, &control::subscriber("t", Qos::PLAIN));
    let mut links = Vec::new();
    for interface in 1..=64 {
        let contract = control::publisher("t", Qos::PLAIN);
        assert_eq!(honest.declare(interface, &contract), 1);
        links.push(honest.linked());
    }
    // The deaf node has the greatest possible number in flight: these two would be the next.
    assert_eq!(other.declare(1, &control::publisher("u", Qos::PLAIN)), 0);
    honest.send(control::declare(65, &control::subscriber("u", Qos::PLAIN)));
    manager.log_says("stalled");
    drop(deaf);
    let ours = loop {
        match honest.next_with_fds() {
            (ToNode::Declared { .. } | ToNode::Unlink { .. }, _) => {}
            (ToNode::Link { link, .. }, _) => break link,
            (frame, _) => panic!("{frame:?}"),
        }
    };
    assert_eq!(other.linked().id, ours);
    eventually("the deaf node's end", || {
        names_now(&honest) == ["honest", "other"]
    });
}
