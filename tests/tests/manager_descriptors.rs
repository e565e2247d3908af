//! A Manager that is short of descriptors: its own, and those in flight to nodes that do not read. It serves nodes
//! that obey SPEC all the time.

use std::sync::{Mutex, PoisonError};

use nix::unistd::{Uid, geteuid};
use sm2_proto::control::{Item, Limit, Limits, Page, ToNode};
use sm2_tests::{
    control::{self, Qos},
    domain::TempDomain,
    eventually,
    raw::RawNode,
};

/// Serializes tests that leave many descriptors in flight, since the kernel counts them per user.
static IN_FLIGHT: Mutex<()> = Mutex::new(());

/// The link ends that a deaf node does not read are descriptors of the Manager. Their number is
/// limited: further links wait until the node reads, and no other node is affected.
//= SM2-LNK-006, SM2-IFC-002, SM2-TRN-008 sys
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
    let baseline = manager.census_when_idle();
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
    let ahead = Limits::default().count(Limit::LinksInFlight);
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
//= SM2-TRN-008, SM2-SES-006, SM2-LNK-009 sys
#[test]
fn a_node_that_does_not_take_its_links_does_not_use_up_the_descriptors() {
    let _alone = IN_FLIGHT.lock().unwrap_or_else(PoisonError::into_inner);
    let domain = TempDomain::new();
    let manager = domain.manager_with(&["--nofile", "128"]);
    let honest = manager.node("honest");
    honest.nodes();
    let baseline = manager.census_when_idle();
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

/// A Manager without a free descriptor for a new connection serves its present ones, and accepts the
/// new one when a descriptor is free.
//= SM2-LNK-008 sys
#[test]
fn a_manager_that_runs_out_of_descriptors_recovers() {
    let domain = TempDomain::new();
    let manager = domain.manager_with(&["--nofile", "40"]);
    let honest = manager.node("honest");
    honest.nodes();
    let baseline = manager.census_when_idle();
    let many: Vec<RawNode> = (0..60).map(|_| manager.connect()).collect();
    manager.log_says("cannot accept a connection");
    assert_eq!(honest.nodes(), ["honest"]);
    // A connection needs more descriptors than a link does, so there may be enough for a link.
    manager.take_free_descriptors();
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
//= SM2-TRN-009 sys
#[test]
fn descriptors_in_flight_that_nobody_takes_cost_the_one_who_does_not() {
    if !geteuid().is_root() {
        sm2_test_support::skip("only root can start a Manager for a user without privileges");
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
