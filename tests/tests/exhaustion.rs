//! A process without free descriptors loses the messages and links that need one. No other process
//! is affected.

use sm2_proto::control::{Item, Page, ToNode};
use sm2_tests::{
    actor::{Actor, number},
    control,
    domain::{ManagerProcess, TempDomain},
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
    let mut links = talker.counted("t");
    links.retain(|it| it.peer == "healthy");
    assert_eq!(links[0].offered, 20, "{links:?}");
    // With free descriptors the listener is linked again. Nobody declares anything for that.
    starved.tell("spit");
    eventually("the starved one to hear again", || {
        talker.tell("publish t 1 10000");
        let taken = healthy.tell("take t 1");
        assert!(taken.ends_with("lost=0 damaged=0"), "{taken}");
        let drained = starved.tell("drain t");
        assert!(drained.ends_with("damaged=0"), "{drained}");
        number(&drained, "got") > 0
    });
}

//= SM2-TRN-012, SM2-LNK-009, SM2-OPN-006 sys
#[test]
fn a_subscriber_that_cannot_take_a_sealed_message_is_linked_again_later() {
    starve("sealed");
}

//= SM2-TRN-012, SM2-LNK-009, SM2-OPN-006 sys
#[test]
fn a_subscriber_that_cannot_take_a_segment_is_linked_again_later() {
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

/// The number of a node's session.
fn session_of(manager: &ManagerProcess, wanted: &str) -> u64 {
    let probe = manager.node("probe");
    probe.send(control::query());
    let ToNode::Page(Page { items, .. }) = probe.next() else {
        panic!("no page");
    };
    let number = |item: &Item| match item {
        Item::Node { node, name, .. } if name.as_str() == wanted => Some(node.0),
        _ => None,
    };
    items.iter().find_map(number).expect("it is there")
}

/// A new link needs a descriptor. A node without a free one is not linked for now. Its session and
/// its other links go on, and no other node is affected.
//= SM2-TRN-012, SM2-LNK-009, SM2-SES-006 sys
#[test]
fn a_node_that_cannot_take_a_link_keeps_its_session_and_its_links() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let socket = domain.socket();
    let mut talker = Actor::start(&socket, "talker");
    talker.tell("pub t t reliable_ms=60000");
    let mut healthy = Actor::start(&socket, "healthy");
    healthy.tell("sub t t reliable");
    let mut starved = Actor::launch(&socket, "starved", &["--nofile", "64"]);
    assert_eq!(starved.answer(), "ready");
    starved.tell("sub t t reliable");
    talker.tell("wait t 2");
    // The segment is attached while there are descriptors.
    let mut talk = |starved: &mut Actor| {
        talker.tell("publish t 1 10000");
        for listener in [&mut healthy, starved] {
            let taken = listener.tell("take t 1");
            assert!(taken.ends_with("lost=0 damaged=0"), "{taken}");
        }
    };
    talk(&mut starved);
    let session = session_of(&manager, "starved");
    starved.tell("eat");
    let mut late = Actor::start(&socket, "late");
    late.tell("pub u t reliable_ms=60000");
    late.tell("wait u 1");
    // Several attempts to make the missing link fail.
    for _ in 0..50 {
        talk(&mut starved);
    }
    assert_eq!(session_of(&manager, "starved"), session);
    hears_again(&mut late, &mut healthy, &mut starved);
    assert_eq!(session_of(&manager, "starved"), session);
}

/// With free descriptors the missing link is made, by itself.
fn hears_again(late: &mut Actor, healthy: &mut Actor, starved: &mut Actor) {
    starved.tell("spit");
    eventually("the starved one to hear the late one", || {
        late.tell("publish u 1 10000");
        healthy.tell("take t 1");
        let drained = starved.tell("drain t");
        assert!(drained.ends_with("damaged=0"), "{drained}");
        number(&drained, "got") > 0
    });
}
