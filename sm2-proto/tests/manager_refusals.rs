//! What the Manager refuses, to whom it gives which links, and whom it gives up.

mod support;

use std::time::Duration;

use sm2_proto::{
    Code, Contract, Farewell, InterfaceId, NodeId, Quota, Refusal, Violation,
    control::{ToManager, ToNode},
    manager::{Cause, Credentials, Input, Manager, Misuse, Policy},
};
use support::{
    bench::{Bench, EPOCH, Event, hello, seen_by, unlink, unlinked},
    contracts::{
        client, data, name, publisher, publisher_with, server, service_qos, subscriber,
        subscriber_with,
    },
};

const UNLIMITED: Policy = Policy {
    greeting: Duration::from_secs(2),
    greetings_per_user: usize::MAX,
    sessions_per_user: usize::MAX,
    interfaces_per_session: usize::MAX,
    interfaces_per_user: usize::MAX,
    links_per_session: usize::MAX,
    seal_all: false,
    waive_user_boundary: false,
};

fn scan() -> Contract {
    publisher("scan", &data("Scan"))
}

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
    // It may try as often as it likes, and another name at once.
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
    // A name that was refused is not taken by that.
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
        let violation = Violation::BadVersionRange;
        let goodbye = Some(violation.code());
        let cause = Cause::Violation(violation);
        let hung_up = Event::HungUp(NodeId(1), goodbye, cause);
        assert_eq!(versions(min, max), [hung_up], "{min} to {max}");
    }
}

//= SM2-SES-003 test
#[test]
fn sessions_per_user() {
    let mut bench = Bench::new(Policy {
        sessions_per_user: 2,
        ..UNLIMITED
    });
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

//= SM2-IFC-006 test
#[test]
fn interfaces_per_session() {
    let mut bench = Bench::new(Policy {
        interfaces_per_session: 2,
        ..UNLIMITED
    });
    let node = bench.node(1, "a");
    bench.declared(node, 1, &scan());
    bench.declared(node, 2, &scan());
    let reason = quota(Quota::InterfacesPerSession, 2);
    assert_eq!(refusal(&bench.declare(node, 3, &scan())), Some(&reason));
    bench.withdraw(node, 1);
    // The number of a refused interface is spent all the same.
    let mut spent = bench.clone();
    let events = spent.declare(node, 3, &scan());
    let cause = Cause::Violation(Violation::InterfaceNumber);
    assert_eq!(events, [Event::HungUp(node, Some(Code(35)), cause)]);
    bench.declared(node, 4, &scan());
    assert_eq!(refusal(&bench.declare(node, 5, &scan())), Some(&reason));
    let other = bench.node(1, "b");
    bench.declared(other, 1, &scan());
}

//= SM2-IFC-006 test
#[test]
fn interfaces_per_user() {
    let mut bench = Bench::new(Policy {
        interfaces_per_user: 2,
        ..UNLIMITED
    });
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
    // All that a session had is given back when it ends.
    bench.close(a);
    bench.declared(b, 3, &scan());
    bench.declared(b, 4, &scan());
    assert_eq!(refusal(&bench.declare(b, 5, &scan())), Some(&reason));
}

//= SM2-MAT-002 test
#[test]
fn links_per_session_of_whoever_declares() {
    let mut bench = Bench::new(Policy {
        links_per_session: 2,
        ..UNLIMITED
    });
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
    // At the limit: an interface without matches is granted, one with a match not.
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
    // Withdrawing gives back what nobody has answered for.
    bench.withdraw(node, 2);
    assert_eq!(bench.declared(node, 5, &wanted).len(), 2);
}

//= SM2-MAT-002 test
#[test]
fn links_per_session_of_the_other_side() {
    let mut bench = Bench::new(Policy {
        links_per_session: 3,
        ..UNLIMITED
    });
    let full = bench.node(1, "full");
    for interface in 1..=5 {
        bench.declared(full, interface, &scan());
    }
    // Its share is counted within one DECLARE too.
    let one = bench.node(1, "one");
    assert_eq!(bench.declared(one, 1, &subscriber("scan", None)).len(), 3);
    // The pair is not linked; the one who declares is granted, and others linked.
    let two = bench.node(1, "two");
    bench.declared(two, 1, &scan());
    let three = bench.node(1, "three");
    assert_eq!(bench.declared(three, 1, &subscriber("scan", None)).len(), 1);
    // Room again: only for whoever declares from then on.
    bench.close(one);
    assert_eq!(bench.manager.links(), 1);
    let told = (1..=3).map(|interface| bench.withdraw(full, interface));
    assert_eq!(told.map(|events| events.len()).sum::<usize>(), 3);
    assert_eq!(bench.manager.links(), 1);
    let four = bench.node(1, "four");
    assert_eq!(bench.declared(four, 1, &subscriber("scan", None)).len(), 3);
}

/// Both ends of a link within one session count there.
//= SM2-MAT-001, SM2-MAT-002 test
#[test]
fn links_within_one_session() {
    for (limit, granted) in [(1, false), (2, true), (3, true)] {
        let mut bench = Bench::new(Policy {
            links_per_session: limit,
            ..UNLIMITED
        });
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
        // Withdrawing one end tells the other, which is the same session.
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
    // Whoever takes any type fixes none.
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
    // A service of that name is something else.
    bench.declared(other, 11, &server("scan", &data("Image"), &data("Image")));
    // The type is free once the last one who stated it is gone.
    bench.declared(other, 12, &scan());
    bench.withdraw(node, 2);
    assert_eq!(refusal(&bench.declare(node, 3, &wrong[0])), Some(&theirs));
    bench.withdraw(other, 12);
    assert_eq!(bench.declared(node, 4, &wrong[0]).len(), 2);
    // Also when it goes without a word.
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

/// The terms on which a link between users `a` and `b` comes to be.
fn terms(policy: Policy, one: (u32, &Contract), other: (u32, &Contract)) -> Option<(bool, bool)> {
    let mut bench = Bench::new(policy);
    let a = bench.node(one.0, "a");
    let b = bench.node(other.0, "b");
    bench.declared(a, 1, one.1);
    let events = bench.declare(b, 1, other.1);
    let ends = events.iter().find_map(|event| match event {
        Event::Linked(_, ends) => Some(ends),
        _ => None,
    })?;
    let terms = [&ends[0], &ends[1]].map(|(_, frame)| match frame {
        ToNode::Link {
            reliable, sealed, ..
        } => (*reliable, *sealed),
        other => panic!("{other:?} is no LINK"),
    });
    assert_eq!(terms[0], terms[1], "both sides are told the same");
    Some(terms[0])
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
                        let policy = Policy {
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
                        assert_eq!(terms(policy, one, other), expected);
                        // It does not matter who comes first.
                        assert_eq!(terms(policy, other, one), expected);
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
        assert_eq!(terms(UNLIMITED, (1, &one), (1, &other)), expected);
        assert_eq!(terms(UNLIMITED, (1, &other), (1, &one)), expected);
        let expected = Some((true, true));
        assert_eq!(terms(UNLIMITED, (1, &one), (2, &other)), expected);
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
        assert_eq!(terms(UNLIMITED, (1, &one), (1, &other)), None);
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
    let frame = |interface, node, text, peer, contract: &Contract| ToNode::Link {
        interface: InterfaceId(interface),
        link: *link,
        version: 1,
        reliable: false,
        sealed: false,
        peer: sm2_proto::control::Peer {
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

//= SM2-LNK-003, SM2-LNK-004 test
#[test]
fn farewells() {
    let linked = || {
        let mut bench = Bench::new(UNLIMITED);
        let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
        bench.declared(a, 1, &scan());
        let link = bench.declared(b, 1, &subscriber("scan", None))[0];
        (bench, a, b, link)
    };
    // a is first: it is answered and b told; b answers, and both are done.
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
        let cause = Cause::Violation(Violation::UnknownLink);
        let hung_up = Event::HungUp(node, Some(Code(37)), cause);
        assert_eq!(events.last(), Some(&hung_up), "a second farewell");
    }
    // Both at once: UNLINKED of b crosses its UNLINK.
    let (mut bench, a, b, link) = linked();
    bench.unlinked(a, 1, link);
    assert_eq!(bench.unlinked(b, 1, link), []);
    // WITHDRAW of a crosses UNLINKED of b.
    let (mut bench, a, b, link) = linked();
    let events = bench.withdraw(a, 1);
    assert_eq!(seen_by(&events, b), [unlink(1, link, 0)]);
    assert_eq!(bench.unlinked(b, 1, link), []);
    // UNLINK is on its way to a, which withdraws and so never answers.
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
    let mut bench = Bench::new(Policy {
        links_per_session: 1,
        ..UNLIMITED
    });
    let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
    bench.declared(a, 1, &scan());
    let before = bench.clone();
    let link = bench.declared(b, 1, &subscriber("scan", None))[0];
    let revision = bench.manager.revision();
    assert_eq!(bench.input(Input::LinkFailed { link }), []);
    assert_eq!(bench.manager.links(), 0);
    assert_ne!(bench.manager.revision(), revision, "a page shows one less");
    // The quota is free again, and withdrawing tells nobody of it.
    assert_eq!(seen_by(&bench.withdraw(b, 1), a), []);
    assert_eq!(bench.declared(b, 2, &subscriber("scan", None)).len(), 1);
    // A number that no link has is nobody's.
    let mut strange = before;
    for epoch in [EPOCH, EPOCH + 1] {
        let link = sm2_proto::LinkId { epoch, serial: 9 };
        assert_eq!(strange.input(Input::LinkFailed { link }), []);
    }
}

//= SM2-TRN-009, SM2-SES-006 test
#[test]
fn whoever_does_not_read_is_given_up() {
    let mut bench = Bench::new(UNLIMITED);
    let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
    bench.declared(a, 1, &scan());
    let link = bench.declared(b, 1, &subscriber("scan", None))[0];
    let events = bench.input(Input::Stalled { session: b });
    let cause = Cause::Farewell(Farewell::Stalled);
    let hung_up = Event::HungUp(b, Some(Code(2)), cause);
    assert_eq!(events, [Event::Sent(a, unlink(1, link, 5)), hung_up]);
    assert_eq!(bench.input(Input::Stalled { session: b }), []);
}

//= SM2-SES-004 test
#[test]
fn whoever_does_not_greet_in_time_is_given_up() {
    let mut bench = Bench::new(UNLIMITED);
    assert_eq!(bench.manager.deadline(), None);
    let start = bench.now;
    let first = bench.connect(1);
    bench.now = start.after(Duration::from_millis(500));
    let second = bench.connect(1);
    let third = bench.connect(1);
    let due = start.after(Duration::from_secs(2));
    assert_eq!(bench.manager.deadline(), Some(due));
    // A refusal does not buy time, a grant ends the wait.
    bench.hello(third, "third");
    assert!(refusal(&bench.hello(second, "third")).is_some());
    let before = sm2_proto::Instant(due.0 - 1);
    bench.now = before;
    assert_eq!(bench.input(Input::Tick), []);
    let hung_up = |session| {
        let cause = Cause::Farewell(Farewell::GreetingTimeout);
        Event::HungUp(session, Some(Code(1)), cause)
    };
    bench.now = due;
    // HELLO in the last moment comes too late.
    let mut late = bench.clone();
    assert_eq!(late.hello(first, "first"), [hung_up(first)]);
    assert_eq!(bench.input(Input::Tick), [hung_up(first)]);
    let due = start.after(Duration::from_millis(2_500));
    assert_eq!(bench.manager.deadline(), Some(due));
    bench.now = due.after(Duration::from_secs(1));
    assert_eq!(bench.input(Input::Tick), [hung_up(second)]);
    assert_eq!(bench.manager.deadline(), None);
    assert!(bench.is_known(third));
}

/// Connections come and go; what is kept of them does not add up.
//= SM2-SES-004 test
#[test]
fn the_deadline_is_that_of_a_session_that_waits() {
    let mut bench = Bench::new(UNLIMITED);
    for _ in 0..1_000 {
        let session = bench.connect(1);
        bench.now = bench.now.after(Duration::from_micros(1));
        bench.close(session);
    }
    assert_eq!(bench.manager.deadline(), None);
    assert_eq!(bench.manager.sessions(), 0);
}

#[test]
fn greetings_per_user() {
    let mut bench = Bench::new(Policy {
        greetings_per_user: 2,
        ..UNLIMITED
    });
    let first = bench.connect(1);
    bench.connect(1);
    let (third, events) = bench.try_connect(1);
    let cause = Cause::Farewell(Farewell::Resources);
    assert_eq!(events, [Event::HungUp(third, Some(Code(4)), cause)]);
    bench.connect(2);
    // Whoever is ready, or gone, does not count any more.
    bench.hello(first, "first");
    bench.connect(1);
    let (_, events) = bench.try_connect(1);
    assert!(matches!(events[..], [Event::HungUp(..)]));
    bench.close(NodeId(2));
    bench.connect(1);
}

//= SM2-SES-007 test
#[test]
fn session_numbers_grow() {
    let mut manager = Manager::new(1, UNLIMITED);
    let credentials = Credentials {
        uid: 1,
        gid: 1,
        pid: 1,
    };
    let mut connect = |session| {
        let session = NodeId(session);
        manager.handle(
            sm2_proto::Instant(0),
            Input::Connected {
                session,
                credentials,
            },
        )
    };
    let misuse = |session| Err(Misuse::SessionNumber(NodeId(session)));
    assert_eq!(connect(0), misuse(0));
    assert_eq!(connect(5), Ok(()));
    assert_eq!(connect(5), misuse(5));
    assert_eq!(connect(4), misuse(4));
    assert_eq!(connect(6), Ok(()));
    assert_eq!(manager.sessions(), 2);
}

//= SM2-SES-008, SM2-NOD-003 test
#[test]
fn a_manager_that_ends_leaves_the_links_alone() {
    let mut bench = Bench::new(UNLIMITED);
    let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
    let greeting = bench.connect(2);
    bench.declared(a, 1, &scan());
    bench.declared(b, 1, &subscriber("scan", None));
    let hung_up = |session| {
        let cause = Cause::Farewell(Farewell::ShuttingDown);
        Event::HungUp(session, Some(Code(3)), cause)
    };
    let events = bench.input(Input::Shutdown);
    assert_eq!(events, [a, b, greeting].map(hung_up));
    assert_eq!((bench.manager.sessions(), bench.manager.links()), (0, 0));
    assert_eq!(bench.manager.deadline(), None);
    assert_eq!(bench.hello(greeting, "late"), []);
}

/// HELLO, DECLARE and all else of one session do not reach another one's.
//= SM2-TRN-007, SM2-IFC-003 test
#[test]
fn interfaces_belong_to_their_session() {
    let mut bench = Bench::new(UNLIMITED);
    let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
    bench.declared(a, 1, &scan());
    let link = bench.declared(b, 2, &subscriber("scan", None))[0];
    for (frame, code) in [
        (support::bench::withdraw(1), 36),
        (unlinked(1, link), 36),
        (hello("a"), 33),
    ] {
        let mut bench = bench.clone();
        let events = bench.send(b, &frame);
        assert!(
            matches!(events.last(), Some(Event::HungUp(session, Some(Code(it)), _))
                if *session == b && *it == code),
            "{events:?}"
        );
        assert!(bench.is_known(a));
    }
}
