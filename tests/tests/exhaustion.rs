//! A process without free descriptors loses the messages and links that need one. No other process
//! is affected.

// Shows DAT-LOCAL, DAT-NOLEAK, MGR-RETRY (test, full).

use sm2_node::explain::{Finding, why};
use sm2_proto::{
    control::{Page, ToNode},
    domain::Domain,
};
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

//= SM2-TRN-011, SM2-LNK-009, SM2-OPN-008 sys
#[test]
fn a_subscriber_that_cannot_take_a_sealed_message_is_linked_again_later() {
    starve("sealed");
}

//= SM2-TRN-011, SM2-LNK-009, SM2-OPN-008 sys
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

/// The items of the domain, which fit into one page.
fn domain_of(manager: &ManagerProcess) -> Domain {
    let probe = manager.node("probe");
    probe.send(control::query());
    let ToNode::Page(Page { items, next, .. }) = probe.next() else {
        panic!("no page");
    };
    assert_eq!(next, None, "one page");
    let mut domain = Domain::new();
    domain.page(items);
    domain
}

/// The number of a node's session.
fn session_of(manager: &ManagerProcess, wanted: &str) -> u64 {
    let domain = domain_of(manager);
    domain.node_named(wanted).expect("it is there").node.0
}

/// A new link needs a descriptor. A node without a free one is not linked for now. Its session and
/// its other links go on, and no other node is affected.
//= SM2-TRN-011, SM2-LNK-009, SM2-SES-006 sys
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

/// How many publishers a process has, and how many of them are left in the end.
const CROWD: u32 = 60;
const LEFT: u32 = 5;

/// A process with few descriptors matches more publishers than it can be linked with. The Manager holds the
/// other links back, says so, and makes them when there is room. No descriptor is ever lost, and the link that
/// the process already had loses no message.
//= SM2-LNK-007 sys
#[test]
fn links_beyond_the_room_of_a_process_wait() {
    let domain = TempDomain::new();
    let manager = domain.manager();
    let socket = domain.socket();
    let mut steady = Actor::start(&socket, "steady");
    steady.tell("pub s s");
    let mut starved = Actor::launch(&socket, "starved", &["--nofile", "64"]);
    assert_eq!(starved.answer(), "ready");
    starved.tell("sub s s depth=100");
    steady.tell("wait s 1");
    let mut crowd = Actor::start(&socket, "crowd");
    for publisher in 0..CROWD {
        crowd.tell(&format!("pub c{publisher} t"));
    }
    starved.tell("sub t t");
    let mut sent = 0;
    let mut hear = |starved: &mut Actor| {
        steady.tell("publish s 10 100");
        sent += 10;
        let taken = starved.tell("take s 10");
        assert!(taken.ends_with("lost=0 damaged=0"), "{taken}");
        assert_eq!(number(&taken, "last"), sent, "{taken}");
    };
    let mut shown = domain_of(&manager);
    let node = shown.node_named("starved").expect("it is there").node;
    // The room changes with the descriptors that are in use at the moment, so the snapshot that is looked at below is
    // one without room.
    eventually("all room to be used", || {
        hear(&mut starved);
        shown = domain_of(&manager);
        let starved = shown.node_named("starved").expect("it is there");
        starved.max_links == Some(shown.known_ends(node))
    });
    let used = shown.known_ends(node);
    assert!(used > LEFT + 1 && used < CROWD, "{used} links");
    let waiting: Vec<_> = shown.waiting_links().collect();
    assert_eq!(waiting.len() as u32, CROWD + 1 - used);
    for (_, offering, demanding) in waiting {
        let no_room = Finding::NoRoom {
            node,
            used,
            max_links: used,
        };
        assert_eq!(why(&shown, offering, demanding).finding, no_room);
    }
    assert!(
        !starved.stderr().contains("no free descriptor"),
        "{}",
        starved.stderr()
    );
    // The newest publishers waited.
    for publisher in 0..CROWD - LEFT {
        crowd.tell(&format!("withdraw c{publisher}"));
    }
    eventually("the waiting links to be made", || {
        hear(&mut starved);
        let domain = domain_of(&manager);
        domain.waiting_links().count() == 0 && domain.known_ends(node) == LEFT + 1
    });
}
