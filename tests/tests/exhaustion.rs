//! A process without free descriptors loses the messages and links that need one. No other process
//! is affected.

use sm2_tests::{
    actor::{Actor, number},
    domain::TempDomain,
    eventually,
};

/// A talker, a healthy listener, and a listener without free descriptors.
fn scene(domain: &TempDomain, demand: &str) -> (Actor, Actor, Actor) {
    let socket = domain.socket();
    let mut talker = Actor::start(&socket, "talker");
    talker.tell("pub t t inline_max=0 reliable_ms=60000");
    let mut healthy = Actor::start(&socket, "healthy");
    healthy.tell(&format!("sub t t reliable {demand}"));
    let mut starved = Actor::launch(&socket, "starved", &["--nofile", "64"]);
    assert_eq!(starved.answer(), "ready");
    starved.tell(&format!("sub t t reliable {demand}"));
    talker.tell("wait t 2");
    starved.tell("eat");
    (talker, healthy, starved)
}

/// The common part of two tests: a descriptor arrives with a segment, or with the message.
fn starve(demand: &str) {
    let domain = TempDomain::new();
    let _manager = domain.manager();
    let (mut talker, mut healthy, mut starved) = scene(&domain, demand);
    for _ in 0..20 {
        talker.tell("publish t 1 10000");
        let taken = healthy.tell("take t 1");
        assert!(taken.ends_with("lost=0 damaged=0"), "{taken}");
    }
    let lost = talker.counted_with("t", "starved");
    assert!(!lost.open, "{lost:?}");
    assert_eq!(
        (lost.offered, lost.in_flight),
        (lost.dropped, 0),
        "{lost:?}"
    );
    assert_eq!(talker.counted_with("t", "healthy").offered, 20);
    // The listener knows of its loss, its session continues, and with free descriptors it can
    // declare again.
    starved.tell("spit");
    starved.tell("close t");
    starved.tell(&format!("sub t t reliable {demand}"));
    talker.tell("wait t 2");
    talker.tell("publish t 1 10000");
    for listener in [&mut starved, &mut healthy] {
        let taken = listener.tell("take t 1");
        assert!(taken.contains("last=21 lost=0 damaged=0"), "{taken}");
    }
}

//= SM2-TRN-005, SM2-OPN-006 sys
#[test]
fn a_subscriber_that_cannot_take_a_sealed_message_loses_its_link() {
    starve("sealed");
}

//= SM2-TRN-005, SM2-OPN-006 sys
#[test]
fn a_subscriber_that_cannot_take_a_segment_loses_its_link() {
    starve("");
}

/// A publisher that cannot make memory for a message reports that, and continues when it can.
#[test]
fn a_publisher_without_descriptors_gets_an_error_and_recovers() {
    let domain = TempDomain::new();
    let _manager = domain.manager();
    for offer in ["", "sealed"] {
        let mut talker = Actor::launch(&domain.socket(), "talker", &["--nofile", "64"]);
        assert_eq!(talker.answer(), "ready");
        let mut listener = Actor::start(&domain.socket(), "listener");
        listener.tell("sub t t reliable");
        talker.tell(&format!("pub t t inline_max=0 reliable_ms=60000 {offer}"));
        talker.tell("wait t 1");
        talker.tell("eat");
        let refused = talker.ask("publish t 1 10000");
        assert!(refused.starts_with("error Store(Io"), "{refused}");
        talker.tell("spit");
        talker.tell("publish t 1 10000");
        let taken = listener.tell("take t 1");
        assert!(
            taken.contains("got=1") && taken.ends_with("damaged=0"),
            "{taken}"
        );
        drop((talker, listener));
    }
}

/// A new link needs a descriptor. A node without a free one leaves the domain until it has one, and
/// no other node is affected.
//= SM2-TRN-005, SM2-SES-006, SM2-RES-001 sys
#[test]
fn a_node_that_cannot_take_a_link_is_gone_alone() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let (mut talker, mut healthy, mut starved) = scene(&domain, "");
    let mut late = Actor::start(&domain.socket(), "late");
    late.tell("pub t t reliable_ms=60000");
    late.tell("wait t 1");
    // The node reconnects again and again, so other sessions get numbers between two probes.
    let mut last = u64::MAX;
    eventually("a session to end and another to begin", || {
        let (next, _) = manager.connect().greet("probe");
        next > std::mem::replace(&mut last, next).saturating_add(1)
    });
    for sender in [&mut talker, &mut late] {
        sender.tell("publish t 1 10000");
        let taken = healthy.tell("take t 1");
        assert!(taken.ends_with("lost=0 damaged=0"), "{taken}");
    }
    // With free descriptors the node stays, and receives from both publishers. A link of the
    // previous session may still consume a message.
    starved.tell("spit");
    let mut heard = 0;
    eventually("the starved one to hear again", || {
        for sender in [&mut talker, &mut late] {
            sender.tell("publish t 1 10000");
        }
        healthy.tell("take t 2");
        let drained = starved.tell("drain t");
        assert!(drained.ends_with("damaged=0"), "{drained}");
        heard += number(&drained, "got");
        heard >= 10
    });
}
