//! The Manager's refusals, and each quota exactly at its limit.

// Shows MGR-QUOTA (test), bound: each quota at its limit.

use crate::support::{
    bench::{Bench, EPOCH, Event, UNLIMITED, seen_by, unlink},
    contracts::{client, data, name, publisher, scan, server, subscriber},
};
use sm2_proto::{
    Code, Farewell, InterfaceId, NodeId, Quota, Refusal,
    control::{Limit, ToManager, ToNode},
    manager::Cause,
    violation,
};

fn refusal(events: &[Event]) -> Option<&Refusal> {
    match events {
        [
            Event::Sent(_, ToNode::DeclareRefused { reason, .. } | ToNode::HelloRefused { reason }),
        ] => Some(reason),
        _ => None,
    }
}

fn quota(quota: Quota, limit: u32) -> Refusal {
    Refusal::Quota { quota, limit }
}

//= SM2-SES-003 test
#[test]
fn a_name_is_taken_until_its_session_ends() {
    let mut bench = Bench::new(UNLIMITED);
    let first = bench.node(1, "arm");
    let second = bench.connect(2);
    assert_eq!(
        refusal(&bench.hello(second, "arm")),
        Some(&Refusal::NameTaken)
    );
    // A node may try again as often as it likes, and with another name at once.
    assert_eq!(
        refusal(&bench.hello(second, "arm")),
        Some(&Refusal::NameTaken)
    );
    bench.close(first);
    let welcome = ToNode::Welcome {
        version: 1,
        epoch: EPOCH,
        node: second,
    };
    assert_eq!(bench.hello(second, "arm"), [Event::Sent(second, welcome)]);
    // A refused greeting does not take the name.
    let third = bench.connect(1);
    bench.hello(third, "arm");
    bench.hello(third, "leg");
    let fourth = bench.connect(1);
    assert!(refusal(&bench.hello(fourth, "leg")).is_some());
}

//= SM2-SES-002, SM2-VER-001 test
#[test]
fn versions() {
    let versions = |min_version, max_version| {
        let mut bench = Bench::new(UNLIMITED);
        let session = bench.connect(1);
        let name = name("arm");
        bench.send(
            session,
            &ToManager::Hello {
                min_version,
                max_version,
                name,
                resuming: false,
            },
        )
    };
    for (min, max) in [(1, 1), (1, 2), (1, u16::MAX)] {
        assert!(
            matches!(
                versions(min, max)[..],
                [Event::Sent(_, ToNode::Welcome { version: 1, .. })]
            ),
            "{min} to {max}"
        );
    }
    for (min, max) in [(2, 2), (2, u16::MAX), (u16::MAX, u16::MAX)] {
        let reason = Refusal::Version { min: 1, max: 1 };
        assert_eq!(
            refusal(&versions(min, max)),
            Some(&reason),
            "{min} to {max}"
        );
    }
    for (min, max) in [(0, 0), (0, 1), (2, 1), (u16::MAX, 1)] {
        let violation = violation!(BadVersionRange, "SM2-SES-002");
        let goodbye = Some(violation.code());
        let cause = Cause::Violation(violation);
        let hung_up = Event::HungUp(NodeId(1), goodbye, cause);
        assert_eq!(versions(min, max), [hung_up], "{min} to {max}");
    }
}

//= SM2-SES-003 test
#[test]
fn sessions_per_user() {
    let mut bench = Bench::new(UNLIMITED.with(Limit::SessionsPerUser, 2));
    let a = bench.node(1, "a");
    bench.node(1, "b");
    let c = bench.connect(1);
    let reason = quota(Quota::SessionsPerUser, 2);
    assert_eq!(refusal(&bench.hello(c, "c")), Some(&reason));
    bench.node(2, "another-user");
    bench.close(a);
    assert_eq!(refusal(&bench.hello(c, "c")), None);
    let d = bench.connect(1);
    assert_eq!(refusal(&bench.hello(d, "d")), Some(&reason));
}

/// One process cannot use up the quotas of its user.
//= SM2-SES-010, SM2-IFC-006 test
#[test]
fn a_process_has_a_share_of_the_quotas_of_its_user() {
    const HOSTILE: i32 = 7;
    let mut bench = Bench::new(
        UNLIMITED
            .with(Limit::GreetingsPerUser, 3)
            .with(Limit::GreetingsPerProcess, 2)
            .with(Limit::SessionsPerUser, 3)
            .with(Limit::SessionsPerProcess, 2)
            .with(Limit::InterfacesPerUser, 3)
            .with(Limit::InterfacesPerProcess, 2),
    );
    let (one, _) = bench.try_connect_from(1, HOSTILE);
    let (two, _) = bench.try_connect_from(1, HOSTILE);
    let (three, events) = bench.try_connect_from(1, HOSTILE);
    let resources = Farewell::Resources;
    let hung_up = Event::HungUp(three, Some(resources.code()), Cause::Farewell(resources));
    assert_eq!(events, [hung_up]);
    // Another process of the user has room, and so has the same number of another user.
    let honest = bench.node(1, "honest");
    let (stranger, events) = bench.try_connect_from(2, HOSTILE);
    assert_eq!(events, []);
    bench.hello(stranger, "stranger");
    for (node, name) in [(one, "one"), (two, "two")] {
        assert_eq!(refusal(&bench.hello(node, name)), None);
    }
    let (four, _) = bench.try_connect_from(1, HOSTILE);
    let reason = quota(Quota::SessionsPerProcess, 2);
    assert_eq!(refusal(&bench.hello(four, "four")), Some(&reason));
    bench.declared(one, 1, &scan());
    bench.declared(two, 1, &scan());
    let reason = quota(Quota::InterfacesPerProcess, 2);
    assert_eq!(refusal(&bench.declare(two, 2, &scan())), Some(&reason));
    bench.declared(honest, 1, &scan());
    bench.declared(stranger, 1, &scan());
    // A process can use again the part of its share that it has given back.
    bench.withdraw(one, 1);
    bench.declared(two, 3, &scan());
    bench.close(one);
    assert_eq!(refusal(&bench.hello(four, "four")), None);
}

/// Processes that the kernel does not tell apart share the quotas of their user only.
//= SM2-SES-010 test
#[test]
fn processes_without_a_number_have_no_share() {
    let mut bench = Bench::new(
        UNLIMITED
            .with(Limit::GreetingsPerProcess, 1)
            .with(Limit::SessionsPerProcess, 1)
            .with(Limit::InterfacesPerProcess, 1),
    );
    for name in ["a", "b", "c"] {
        let (node, events) = bench.try_connect_from(1, 0);
        assert_eq!(events, []);
        assert_eq!(refusal(&bench.hello(node, name)), None);
        bench.declared(node, 1, &scan());
        bench.declared(node, 2, &scan());
    }
}

//= SM2-IFC-006 test
#[test]
fn interfaces_per_session() {
    let mut bench = Bench::new(UNLIMITED.with(Limit::InterfacesPerSession, 2));
    let node = bench.node(1, "a");
    bench.declared(node, 1, &scan());
    bench.declared(node, 2, &scan());
    let reason = quota(Quota::InterfacesPerSession, 2);
    assert_eq!(refusal(&bench.declare(node, 3, &scan())), Some(&reason));
    bench.withdraw(node, 1);
    // The number of a refused interface is spent all the same.
    let mut spent = bench.clone();
    let events = spent.declare(node, 3, &scan());
    let cause = Cause::Violation(violation!(BadInterfaceId, "SM2-IFC-001"));
    assert_eq!(events, [Event::HungUp(node, Some(Code(35)), cause)]);
    bench.declared(node, 4, &scan());
    assert_eq!(refusal(&bench.declare(node, 5, &scan())), Some(&reason));
    let other = bench.node(1, "b");
    bench.declared(other, 1, &scan());
}

//= SM2-IFC-006 test
#[test]
fn interfaces_per_user() {
    let mut bench = Bench::new(UNLIMITED.with(Limit::InterfacesPerUser, 2));
    let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
    let reason = quota(Quota::InterfacesPerUser, 2);
    bench.declared(a, 1, &scan());
    bench.declared(b, 1, &scan());
    assert_eq!(refusal(&bench.declare(a, 2, &scan())), Some(&reason));
    let other = bench.node(2, "another-user");
    bench.declared(other, 1, &scan());
    bench.withdraw(b, 1);
    bench.declared(a, 3, &scan());
    assert_eq!(refusal(&bench.declare(b, 2, &scan())), Some(&reason));
    // All charges of a session are given back when it ends.
    bench.close(a);
    bench.declared(b, 3, &scan());
    bench.declared(b, 4, &scan());
    assert_eq!(refusal(&bench.declare(b, 5, &scan())), Some(&reason));
}

//= SM2-MAT-002 test
#[test]
fn links_per_session_of_the_declaring_node() {
    let mut bench = Bench::new(UNLIMITED.with(Limit::LinksPerSession, 2));
    let mut publishers = Vec::new();
    for text in ["a", "b", "c"] {
        let node = bench.node(1, text);
        bench.declared(node, 1, &scan());
        publishers.push(node);
    }
    let node = bench.node(1, "subscriber");
    let reason = quota(Quota::LinksPerSession, 2);
    let wanted = subscriber("scan", None);
    assert_eq!(refusal(&bench.declare(node, 1, &wanted)), Some(&reason));
    assert_eq!(bench.manager.links(), 0, "all or nothing");
    bench.withdraw(publishers[0], 1);
    assert_eq!(bench.declared(node, 2, &wanted).len(), 2);
    // At the limit, an interface without matches is granted, and one with a match is refused.
    bench.declared(node, 3, &subscriber("image", None));
    assert_eq!(refusal(&bench.declare(node, 4, &wanted)), Some(&reason));
    // A link that has ended counts until both farewells are said.
    let told = bench.withdraw(publishers[1], 1);
    let [ToNode::Unlink { link, .. }] = seen_by(&told, node)[..] else {
        panic!("{told:?}");
    };
    bench.withdraw(publishers[2], 1);
    bench.declared(publishers[0], 2, &scan());
    assert_eq!(bench.manager.links(), 0);
    assert_eq!(bench.unlinked(node, 2, link), []);
    assert_eq!(bench.declared(publishers[1], 2, &scan()).len(), 1);
    // WITHDRAW gives back the links whose farewells were never answered.
    bench.withdraw(node, 2);
    assert_eq!(bench.declared(node, 5, &wanted).len(), 2);
}

//= SM2-MAT-002 test
#[test]
fn links_per_session_of_the_other_side() {
    let mut bench = Bench::new(UNLIMITED.with(Limit::LinksPerSession, 3));
    let full = bench.node(1, "full");
    for interface in 1..=5 {
        bench.declared(full, interface, &scan());
    }
    // The links of one DECLARE count together, too.
    let one = bench.node(1, "one");
    assert_eq!(bench.declared(one, 1, &subscriber("scan", None)).len(), 3);
    // The pair is not linked. The interface is granted and linked with others.
    let two = bench.node(1, "two");
    bench.declared(two, 1, &scan());
    let three = bench.node(1, "three");
    assert_eq!(bench.declared(three, 1, &subscriber("scan", None)).len(), 1);
    // There is room again, but only interfaces declared from then on use it.
    bench.close(one);
    assert_eq!(bench.manager.links(), 1);
    let told = (1..=3).map(|interface| bench.withdraw(full, interface));
    assert_eq!(told.map(|events| events.len()).sum::<usize>(), 3);
    assert_eq!(bench.manager.links(), 1);
    let four = bench.node(1, "four");
    assert_eq!(bench.declared(four, 1, &subscriber("scan", None)).len(), 3);
}

/// Both ends of a link within one session count.
//= SM2-MAT-001, SM2-MAT-002 test
#[test]
fn links_within_one_session() {
    for (limit, granted) in [(1, false), (2, true), (3, true)] {
        let mut bench = Bench::new(UNLIMITED.with(Limit::LinksPerSession, limit));
        let node = bench.node(1, "self");
        bench.declared(node, 1, &scan());
        let events = bench.declare(node, 2, &subscriber("scan", None));
        assert_eq!(refusal(&events).is_none(), granted, "{limit}");
        if !granted {
            continue;
        }
        let frames = seen_by(&events, node);
        let [
            ToNode::Declared { matches: 1, .. },
            ToNode::Link {
                interface: ours,
                link,
                ..
            },
            ToNode::Link {
                interface: theirs, ..
            },
        ] = &frames[..]
        else {
            panic!("{frames:?}");
        };
        assert_eq!((ours, theirs), (&InterfaceId(2), &InterfaceId(1)));
        // Either end has its own farewells.
        let both = [unlink(1, *link, 5), unlink(2, *link, 5)];
        assert_eq!(seen_by(&bench.unlinked(node, 1, *link), node), both);
        assert_eq!(bench.unlinked(node, 2, *link), []);
        assert!(bench.is_known(node));
        bench.withdraw(node, 2);
        let again = bench.declared(node, 3, &subscriber("scan", None));
        assert_eq!(again.len(), 1);
        // Withdrawing one end tells the other end, which belongs to the same session.
        let frames = seen_by(&bench.withdraw(node, 1), node);
        let gone = ToNode::Withdrawn {
            interface: InterfaceId(1),
        };
        assert_eq!(frames, [unlink(3, again[0], 0), gone]);
        assert!(matches!(bench.close(node)[..], [Event::HungUp(..)]));
    }
}

//= SM2-IFC-005, SM2-NAM-002, SM2-NAM-003 test
#[test]
fn types_of_a_topic() {
    let mut bench = Bench::new(UNLIMITED);
    let node = bench.node(1, "a");
    let other = bench.node(2, "b");
    let mut scan2 = data("Scan");
    scan2.hash += 1;
    let theirs = Refusal::TopicType {
        theirs: data("Scan"),
    };
    // A subscriber of any type fixes no type.
    bench.declared(node, 1, &subscriber("scan", None));
    bench.declared(node, 2, &subscriber("scan", Some(&data("Scan"))));
    let wrong = [
        publisher("scan", &data("Image")),
        publisher("scan", &scan2),
        subscriber("scan", Some(&data("Image"))),
    ];
    let mut interface = 0;
    for contract in &wrong {
        interface += 1;
        let events = bench.declare(other, interface, contract);
        assert_eq!(refusal(&events), Some(&theirs), "{contract:?}");
    }
    bench.declared(other, 10, &subscriber("scan", None));
    // A service of that name is independent.
    bench.declared(other, 11, &server("scan", &data("Image"), &data("Image")));
    // The type is free once the last interface that states it is gone.
    bench.declared(other, 12, &scan());
    bench.withdraw(node, 2);
    assert_eq!(refusal(&bench.declare(node, 3, &wrong[0])), Some(&theirs));
    bench.withdraw(other, 12);
    assert_eq!(bench.declared(node, 4, &wrong[0]).len(), 2);
    // Also when the session ends without GOODBYE.
    bench.close(node);
    bench.declared(other, 13, &scan());
}

//= SM2-IFC-005 test
#[test]
fn types_of_a_service() {
    let (goal, result, image) = (data("Goal"), data("Result"), data("Image"));
    let mut bench = Bench::new(UNLIMITED);
    let node = bench.node(1, "a");
    bench.declared(node, 1, &client("plan", None));
    bench.declared(node, 2, &client("plan", Some((&goal, &result))));
    let theirs = Refusal::ServiceType {
        request: goal.clone(),
        reply: result.clone(),
    };
    let wrong = [
        server("plan", &goal, &image),
        server("plan", &image, &result),
        server("plan", &result, &goal),
        client("plan", Some((&image, &result))),
    ];
    let mut interface = 2;
    for contract in &wrong {
        interface += 1;
        let events = bench.declare(node, interface, contract);
        assert_eq!(refusal(&events), Some(&theirs), "{contract:?}");
    }
    assert_eq!(
        bench
            .declared(node, 20, &server("plan", &goal, &result))
            .len(),
        2
    );
    bench.withdraw(node, 2);
    bench.withdraw(node, 20);
    assert_eq!(bench.declared(node, 21, &wrong[0]).len(), 1);
}

#[test]
fn greetings_per_user() {
    let mut bench = Bench::new(UNLIMITED.with(Limit::GreetingsPerUser, 2));
    let first = bench.connect(1);
    bench.connect(1);
    let (third, events) = bench.try_connect(1);
    let cause = Cause::Farewell(Farewell::Resources);
    assert_eq!(events, [Event::HungUp(third, Some(Code(4)), cause)]);
    bench.connect(2);
    // A session that is ready, or gone, is not charged as greeting any more.
    bench.hello(first, "first");
    bench.connect(1);
    let (_, events) = bench.try_connect(1);
    assert!(matches!(events[..], [Event::HungUp(..)]));
    bench.close(NodeId(2));
    bench.connect(1);
}
