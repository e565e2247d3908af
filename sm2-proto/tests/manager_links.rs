//! The pairs that the Manager links, the QoS of the links, and how links end.

// Shows MGR-MATCH (test).

use crate::support::{
    bench::{Bench, EPOCH, Event, UNLIMITED, seen_by, unlink},
    contracts::{
        client, data, name, publisher, publisher_with, scan, server, service_qos, subscriber,
        subscriber_with,
    },
};
use sm2_proto::{
    Code, Contract, InterfaceId, Machine,
    control::{Limit, Limits, LinkPeer, ToNode},
    manager::{Cause, Input},
    violation,
};

/// The QoS of a link between users `a` and `b`.
fn qos(limits: Limits, one: (u32, &Contract), other: (u32, &Contract)) -> Option<(bool, bool)> {
    let mut bench = Bench::new(limits);
    let a = bench.node(one.0, "a");
    let b = bench.node(other.0, "b");
    bench.declared(a, 1, one.1);
    let events = bench.declare(b, 1, other.1);
    let ends = events.iter().find_map(|event| match event {
        Event::Linked(_, ends) => Some(ends),
        _ => None,
    })?;
    let qos = [&ends[0], &ends[1]].map(|(_, frame)| match frame {
        ToNode::Link {
            reliable, sealed, ..
        } => (*reliable, *sealed),
        other => panic!("{other:?} is no LINK"),
    });
    assert_eq!(qos[0], qos[1], "both sides are told the same");
    Some(qos[0])
}

//= SM2-MAT-001, SM2-MAT-003, SM2-LNK-001 test
#[test]
fn terms_of_topics() {
    // offered, demanded: reliable; then matched, reliable.
    let reliability = [
        ((false, false), Some(false)),
        ((false, true), None),
        ((true, false), Some(false)),
        ((true, true), Some(true)),
    ];
    let booleans = [false, true];
    for ((offered, demanded), reliable) in reliability {
        for publisher_seals in booleans {
            for subscriber_seals in booleans {
                for seal_all in booleans {
                    for (other_user, waive) in
                        [(false, false), (false, true), (true, false), (true, true)]
                    {
                        let limits = Limits {
                            seal_all,
                            waive_user_boundary: waive,
                            ..UNLIMITED
                        };
                        let one = publisher_with("t", &data("T"), offered, publisher_seals);
                        let other = subscriber_with("t", None, demanded, subscriber_seals);
                        let (one, other) = ((1, &one), (1 + u32::from(other_user), &other));
                        let sealed = publisher_seals
                            || subscriber_seals
                            || seal_all
                            || (other_user && !waive);
                        let expected = reliable.map(|reliable| (reliable, sealed));
                        assert_eq!(qos(limits, one, other), expected);
                        // The order of the declarations does not matter.
                        assert_eq!(qos(limits, other, one), expected);
                    }
                }
            }
        }
    }
}

//= SM2-MAT-003 test
#[test]
fn terms_of_services() {
    for sealed in [false, true] {
        let mut one = server("s", &data("A"), &data("B"));
        if let Contract::Server { qos, .. } = &mut one {
            *qos = service_qos(sealed);
        }
        let other = client("s", None);
        let expected = Some((true, sealed));
        assert_eq!(qos(UNLIMITED, (1, &one), (1, &other)), expected);
        assert_eq!(qos(UNLIMITED, (1, &other), (1, &one)), expected);
        let expected = Some((true, true));
        assert_eq!(qos(UNLIMITED, (1, &one), (2, &other)), expected);
    }
}

//= SM2-MAT-001, SM2-NAM-001 test
#[test]
fn what_does_not_match() {
    let (a, b) = (data("A"), data("B"));
    for (one, other) in [
        (publisher("t", &a), publisher("t", &a)),
        (subscriber("t", Some(&a)), subscriber("t", Some(&a))),
        (server("t", &a, &b), server("t", &a, &b)),
        (client("t", None), client("t", None)),
        (publisher("t", &a), client("t", None)),
        (server("t", &a, &b), subscriber("t", None)),
        (publisher("t", &a), subscriber("T", None)),
        (publisher("t/u", &a), subscriber("t", None)),
    ] {
        assert_eq!(qos(UNLIMITED, (1, &one), (1, &other)), None);
    }
}

//= SM2-LNK-001, SM2-LNK-002, SM2-FRM-004, SM2-VER-002 test
#[test]
fn a_link_names_each_side_to_the_other() {
    let mut bench = Bench::new(UNLIMITED);
    let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
    bench.declared(a, 3, &scan());
    let wanted = subscriber("scan", None);
    let events = bench.declare(b, 4, &wanted);
    let Some(Event::Linked(link, ends)) = events.last() else {
        panic!("{events:?}");
    };
    let ToNode::Link { key, .. } = ends[0].1 else {
        panic!("{ends:?}");
    };
    let frame = |interface, node, text, peer, contract: &Contract| ToNode::Link {
        interface: InterfaceId(interface),
        link: *link,
        key,
        version: 1,
        reliable: false,
        sealed: false,
        peer: LinkPeer {
            node,
            name: name(text),
            interface: InterfaceId(peer),
            contract: contract.clone(),
        },
    };
    let expected = [
        (b, frame(4, a, "a", 3, &scan())),
        (a, frame(3, b, "b", 4, &wanted)),
    ];
    assert_eq!(*ends, expected);
    assert_eq!(link.epoch, EPOCH);
    // The number is not used again, not even for the same pair.
    bench.withdraw(b, 4);
    let again = bench.declared(b, 5, &wanted);
    assert!(again[0].serial > link.serial);
}

//= SM2-LNK-003, SM2-LNK-009 test
#[test]
fn farewells() {
    let linked = || {
        let mut bench = Bench::new(UNLIMITED);
        let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
        bench.declared(a, 1, &scan());
        let link = bench.declared(b, 1, &subscriber("scan", None))[0];
        (bench, a, b, link)
    };
    // a closes first: it is answered, and b is told. b answers, and both are done.
    let (mut bench, a, b, link) = linked();
    let events = bench.unlinked(a, 1, link);
    let said = |node| Event::Sent(node, unlink(1, link, 5));
    assert_eq!(events, [said(a), said(b)]);
    assert_eq!(bench.unlinked(b, 1, link), []);
    // The pair is not linked again as long as both interfaces live.
    assert_eq!(bench.manager.links(), 0);
    for node in [a, b] {
        let mut bench = bench.clone();
        let events = bench.unlinked(node, 1, link);
        let cause = Cause::Violation(violation!(UnknownLink, "SM2-LNK-003"));
        let hung_up = Event::HungUp(node, Some(Code(37)), cause);
        assert_eq!(events.last(), Some(&hung_up), "a second farewell");
    }
    // Both at once: UNLINKED of b crosses the Manager's UNLINK.
    let (mut bench, a, b, link) = linked();
    bench.unlinked(a, 1, link);
    assert_eq!(bench.unlinked(b, 1, link), []);
    // WITHDRAW of a crosses UNLINKED of b.
    let (mut bench, a, b, link) = linked();
    let events = bench.withdraw(a, 1);
    assert_eq!(seen_by(&events, b), [unlink(1, link, 0)]);
    assert_eq!(bench.unlinked(b, 1, link), []);
    // UNLINK is in flight to a, which withdraws and so never answers.
    let (mut bench, a, b, link) = linked();
    bench.unlinked(b, 1, link);
    let gone = ToNode::Withdrawn {
        interface: InterfaceId(1),
    };
    assert_eq!(bench.withdraw(a, 1), [Event::Sent(a, gone)]);
    assert!(bench.is_known(a) && bench.is_known(b));
}

//= SM2-IFC-002 test
#[test]
fn a_link_without_descriptors_never_was() {
    let mut bench = Bench::new(UNLIMITED.with(Limit::LinksPerSession, 1));
    let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
    bench.declared(a, 1, &scan());
    let before = bench.clone();
    let link = bench.declared(b, 1, &subscriber("scan", None))[0];
    let revision = bench.manager.revision();
    assert_eq!(bench.input(Input::LinkFailed { link }), []);
    assert_eq!(bench.manager.links(), 0);
    assert_ne!(bench.manager.revision(), revision, "a page shows one less");
    // The quota is free again, and the withdrawal causes no UNLINK.
    assert_eq!(seen_by(&bench.withdraw(b, 1), a), []);
    assert_eq!(bench.declared(b, 2, &subscriber("scan", None)).len(), 1);
    // A number of no link.
    let mut strange = before;
    for epoch in [EPOCH, EPOCH + 1] {
        let link = sm2_proto::LinkId { epoch, serial: 9 };
        assert_eq!(strange.input(Input::LinkFailed { link }), []);
    }
}

/// After a shortage of descriptors, the Manager makes the missing links by itself.
/// On a busy machine the Manager's timer fires late.
//= SM2-LNK-008 test
#[test]
fn an_attempt_that_comes_late_is_made() {
    let mut bench = Bench::new(UNLIMITED);
    let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
    bench.declared(a, 1, &scan());
    let link = bench.declared(b, 1, &subscriber("scan", None))[0];
    bench.input(Input::LinkFailed { link });
    bench.now.0 += 60_000_000_000;
    assert_eq!(made(&bench.input(Input::Tick)).len(), 1);
    assert_eq!(bench.manager.links(), 1);
}

//= SM2-LNK-008 test
#[test]
fn a_link_without_descriptors_is_made_later() {
    const MILLI: u64 = 1_000_000;
    let mut bench = Bench::new(UNLIMITED);
    let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
    bench.declared(a, 1, &scan());
    bench.declared(a, 2, &scan());
    let mut links = bench.declared(b, 1, &subscriber("scan", None));
    let mut delays = Vec::new();
    for _ in 0..9 {
        assert_eq!(links.len(), 2, "each attempt asks for both");
        for link in links {
            assert_eq!(bench.input(Input::LinkFailed { link }), []);
        }
        assert_eq!(bench.manager.links(), 0);
        // Before the deadline nothing is tried.
        assert_eq!(bench.input(Input::Tick), []);
        let at = bench.manager.deadline().expect("another attempt");
        delays.push((at.0 - bench.now.0) / MILLI);
        bench.now = at;
        links = made(&bench.input(Input::Tick));
    }
    assert_eq!(delays, [10, 20, 40, 80, 160, 320, 640, 1_000, 1_000]);
    assert_eq!(bench.manager.links(), 2, "the last attempt has not failed");
    assert_eq!(bench.manager.deadline(), None);
    // Attempts were possible for 1 s: the next failure is a first one.
    bench.now.0 += 1_000 * MILLI;
    let link = bench.declared(b, 2, &subscriber("scan", None))[0];
    bench.input(Input::LinkFailed { link });
    let at = bench.manager.deadline().expect("another attempt");
    assert_eq!(at.0 - bench.now.0, 10 * MILLI);
    // A pair of an interface that is gone is not tried again.
    bench.withdraw(b, 2);
    assert_eq!(bench.manager.deadline(), None);
    // Nor is a pair whose interface goes with its session.
    let link = bench.declared(b, 3, &subscriber("scan", None))[0];
    bench.input(Input::LinkFailed { link });
    bench.close(a);
    assert_eq!(bench.manager.deadline(), None);
}

fn made(events: &[Event]) -> Vec<sm2_proto::LinkId> {
    let link = |event: &Event| match event {
        Event::Linked(link, _) => Some(*link),
        _ => None,
    };
    events.iter().filter_map(link).collect()
}
