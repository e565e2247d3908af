//! SPEC section 4.1, cell by cell: the effect of each frame in each state. A violation ends the
//! session that committed it and affects no other one.

// Shows MGR-STRICT, MGR-ABSORB, MGR-NOISE (test), bound: the whole table.

use crate::support::{
    access::{access, deny, finish_work, tables},
    bench::{
        Bench, EPOCH, Event, claim, hello, resuming, seen_by, suspended, unlink, unlinked, withdraw,
    },
    contracts::{data, name, publisher, subscriber},
};
use sm2_proto::{
    Code, Contract, Datagram, FdFacts, InterfaceId, LinkId, NodeId, Seals, TypeId, Violation,
    control::{Limits, SchemaText, ToManager, ToNode, encode_to_manager},
    manager::{Cause, Input, PHASES, Phase, TO_MANAGER_KINDS, ToManagerKind, legal},
    policy::Action,
    schema::Schema,
    violation,
};

/// Rows are states, columns are frames.
const TABLE: &str = "
    -         Hello             Declare         Withdraw        Unlinked        Query           Goodbye
    Greeting  ok                expected-hello  expected-hello  expected-hello  expected-hello  ok
    Resuming  unexpected-hello  ok              ok              ok              ok              ok
    Ready     unexpected-hello  ok              ok              ok              ok              ok

    -         Claim             Claimed
    Greeting  expected-hello    expected-hello
    Resuming  ok                ok
    Ready     unexpected-claim  unexpected-claim

    -         Watch           Counters        Inspect         Schema          Describe        MaxLinks
    Greeting  expected-hello  expected-hello  expected-hello  expected-hello  expected-hello  expected-hello
    Resuming  ok              ok              ok              ok              ok              ok
    Ready     ok              ok              ok              ok              ok              ok

    -         Reload          Suspended
    Greeting  expected-hello  expected-hello
    Resuming  ok              ok
    Ready     ok              ok
";

/// The tables side by side.
fn cells(tables: &str) -> Vec<Vec<String>> {
    let mut joined: Vec<Vec<String>> = Vec::new();
    for table in tables.split("\n\n") {
        let rows = table.lines().map(str::split_whitespace);
        let rows = rows.map(|row| row.map(str::to_owned).collect::<Vec<_>>());
        let rows: Vec<_> = rows.filter(|row| !row.is_empty()).collect();
        if joined.is_empty() {
            joined = rows;
            continue;
        }
        assert_eq!(joined.len(), rows.len());
        for (row, more) in joined.iter_mut().zip(rows) {
            assert!(row[0] == more[0], "rows stand side by side");
            row.extend_from_slice(&more[1..]);
        }
    }
    joined
}

fn cell(outcome: Result<(), Violation>) -> String {
    outcome.err().map_or("ok", |it| it.kind().name()).to_owned()
}

//= SM2-SES-001 test
#[test]
fn every_state_and_frame() {
    let mut actual = vec![vec!["-".to_owned()]];
    actual[0].extend(TO_MANAGER_KINDS.map(|kind| format!("{kind:?}")));
    for phase in PHASES {
        let mut row = vec![format!("{phase:?}")];
        row.extend(TO_MANAGER_KINDS.map(|kind| cell(legal(phase, kind))));
        actual.push(row);
    }
    assert_eq!(actual, cells(TABLE));
}

/// A domain with an honest pair, and one more session: the offender.
struct Scene {
    bench: Bench,
    publisher: NodeId,
    subscriber: NodeId,
    offender: NodeId,
    /// The offender's link with the honest publisher, if it is ready; its claim, if it is resuming.
    link: Option<LinkId>,
}

/// A link of an earlier Manager.
const OLD_LINK: LinkId = LinkId {
    epoch: EPOCH - 1,
    serial: 1,
};

fn contract() -> Contract {
    subscriber("scan", Some(&data("Scan")))
}

fn scene(phase: Phase) -> Scene {
    let mut bench = Bench::new(Limits::default());
    let publisher_node = bench.node(1000, "lidar");
    bench.declared(publisher_node, 1, &publisher("scan", &data("Scan")));
    let subscriber_node = bench.node(1000, "planner");
    bench.declared(subscriber_node, 1, &contract());
    let offender = bench.connect(1000);
    let link = match phase {
        Phase::Greeting => None,
        Phase::Resuming => {
            bench.send(offender, &resuming("offender"));
            assert_eq!(bench.declared(offender, 7, &contract()), []);
            bench.send(offender, &claim(7, OLD_LINK, 1));
            Some(OLD_LINK)
        }
        Phase::Ready => {
            bench.hello(offender, "offender");
            Some(bench.declared(offender, 7, &contract())[0])
        }
    };
    Scene {
        bench,
        publisher: publisher_node,
        subscriber: subscriber_node,
        offender,
        link,
    }
}

/// A frame that is legal if the state allows its kind at all.
fn frame(kind: ToManagerKind, link: Option<LinkId>) -> ToManager {
    let nowhere = LinkId {
        epoch: EPOCH,
        serial: 99,
    };
    match kind {
        ToManagerKind::Hello => hello("newcomer"),
        ToManagerKind::Declare => ToManager::Declare {
            interface: InterfaceId(8),
            contract: contract(),
        },
        ToManagerKind::Withdraw => withdraw(7),
        ToManagerKind::Unlinked => unlinked(7, link.unwrap_or(nowhere)),
        ToManagerKind::Query => ToManager::Query { after: None },
        ToManagerKind::Goodbye => ToManager::Goodbye { code: Code(0) },
        ToManagerKind::Claim => claim(
            7,
            LinkId {
                serial: 2,
                ..OLD_LINK
            },
            1,
        ),
        ToManagerKind::Claimed => ToManager::Claimed,
        ToManagerKind::Watch => ToManager::Watch { after: 0 },
        ToManagerKind::Counters => ToManager::Counters,
        ToManagerKind::Inspect => ToManager::Inspect { node: NodeId(1) },
        ToManagerKind::Schema => ToManager::Schema(SchemaText {
            data: TypeId {
                name: name("Byte"),
                hash: Schema::parse(BYTE).expect("a schema").hash(),
            },
            text: BYTE.to_owned(),
        }),
        ToManagerKind::Describe => ToManager::Describe { data: data("Scan") },
        ToManagerKind::MaxLinks => ToManager::MaxLinks { max_links: 0 },
        ToManagerKind::Reload => ToManager::Reload,
        ToManagerKind::Suspended => suspended(7),
    }
}

const BYTE: &str = "plain:u8";

/// Denies all interfaces.
fn suspend_all(bench: &mut Bench) {
    let rule = deny("nothing", Action::Subscribe, &["**"], &[]);
    bench.input(Input::SetAccessPolicy(access(tables(vec![rule]))));
    finish_work(bench);
}

/// Sends a frame, and the descriptor that belongs to it.
fn send(scene: &mut Scene, kind: ToManagerKind) -> Vec<Event> {
    let frame = frame(kind, scene.link);
    let bytes = encode_to_manager(&frame);
    let counters = [FdFacts {
        regular: true,
        size_bytes: 1_024,
        seals: Seals::POOLED,
    }];
    let datagram = Datagram {
        fds: &counters[..usize::from(kind == ToManagerKind::Counters)],
        ..Datagram::new(&bytes)
    };
    scene.bench.datagram(scene.offender, datagram)
}

//= SM2-SES-001, SM2-SES-005 test
#[test]
fn end_to_end() {
    for phase in PHASES {
        for kind in TO_MANAGER_KINDS {
            let mut scene = scene(phase);
            if kind == ToManagerKind::Suspended {
                suspend_all(&mut scene.bench);
            }
            let events = send(&mut scene, kind);
            let hang_up = events.iter().find_map(|event| match event {
                Event::HungUp(session, code, cause) => Some((*session, *code, *cause)),
                _ => None,
            });
            let expected = match (legal(phase, kind), kind) {
                (Err(violation), _) => Some((
                    scene.offender,
                    Some(violation.code()),
                    Cause::Violation(violation),
                )),
                // The Manager does not answer a node that has said goodbye.
                (Ok(()), ToManagerKind::Goodbye) => {
                    Some((scene.offender, None, Cause::Goodbye(Code(0))))
                }
                (Ok(()), _) => None,
            };
            assert_eq!(hang_up, expected, "{phase:?} {kind:?}: {events:?}");
            assert_eq!(
                scene.bench.is_known(scene.offender),
                expected.is_none(),
                "{phase:?} {kind:?}"
            );
        }
    }
}

/// Every way of a ready session to break SPEC, as the datagram that does it.
fn breaches(link: LinkId) -> Vec<(Violation, Vec<u8>, usize)> {
    let other_epoch = LinkId {
        epoch: EPOCH + 1,
        ..link
    };
    let other_serial = LinkId {
        serial: link.serial + 1,
        ..link
    };
    let declare = |interface| ToManager::Declare {
        interface: InterfaceId(interface),
        contract: contract(),
    };
    let frames = [
        (violation!(UnexpectedHello, "SM2-SES-001"), hello("x")),
        (violation!(BadInterfaceId, "SM2-IFC-001"), declare(0)),
        (violation!(BadInterfaceId, "SM2-IFC-001"), declare(6)),
        (violation!(BadInterfaceId, "SM2-IFC-001"), declare(7)),
        (violation!(UnknownInterface, "SM2-IFC-003"), withdraw(0)),
        (violation!(UnknownInterface, "SM2-IFC-003"), withdraw(8)),
        (
            violation!(UnknownInterface, "SM2-LNK-003"),
            unlinked(8, link),
        ),
        (
            violation!(UnknownLink, "SM2-LNK-003"),
            unlinked(7, other_epoch),
        ),
        (
            violation!(UnknownLink, "SM2-LNK-003"),
            unlinked(7, other_serial),
        ),
        (violation!(UnexpectedSuspended, "SM2-ACC-014"), suspended(7)),
        (
            violation!(BadSchema, "SM2-SCH-001"),
            ToManager::Schema(SchemaText {
                data: data("Scan"),
                text: BYTE.to_owned(),
            }),
        ),
    ];
    let mut breaches: Vec<_> = frames
        .iter()
        .map(|(violation, frame)| (*violation, encode_to_manager(frame), 0))
        .collect();
    breaches.extend([
        (violation!(FrameTooLong, "SM2-TRN-004"), vec![0; 65_537], 0),
        (violation!(UnknownFrame, "SM2-FRM-001"), vec![16], 0),
        (violation!(Malformed, "SM2-FRM-001"), vec![2], 0),
        (violation!(TrailingBytes, "SM2-FRM-001"), vec![2, 7, 0], 0),
        (violation!(NotCanonical, "SM2-FRM-002"), vec![2, 0x87, 0], 0),
        (
            violation!(BadName, "SM2-NAM-001"),
            vec![0, 1, 1, 1, b' '],
            0,
        ),
        (violation!(FdCount, "SM2-TRN-010"), vec![2, 7], 1),
        (violation!(FdCount, "SM2-TRN-010"), vec![9], 0),
        (violation!(NotAMemfd, "SM2-CNT-001"), vec![9], 1),
    ]);
    breaches
}

fn offend(scene: &mut Scene, bytes: &[u8], fds: usize) -> Vec<Event> {
    let fds = vec![FdFacts::default(); fds];
    let datagram = Datagram {
        fds: &fds,
        ..Datagram::new(bytes)
    };
    scene.bench.datagram(scene.offender, datagram)
}

/// The rules that only a resuming session can break, and rules that hold for every session.
fn breaches_while_resuming() -> Vec<(Violation, Vec<u8>, usize)> {
    let own = LinkId {
        epoch: EPOCH,
        ..OLD_LINK
    };
    let claims = [
        (violation!(BadClaim, "SM2-RES-003"), claim(7, OLD_LINK, 1)),
        (violation!(BadClaim, "SM2-RES-003"), claim(7, own, 1)),
        (
            violation!(UnknownInterface, "SM2-RES-003"),
            claim(8, OLD_LINK, 1),
        ),
    ];
    let claims = claims.map(|(rule, frame)| (rule, encode_to_manager(&frame), 0));
    let mut breaches = breaches(OLD_LINK);
    breaches.extend(claims);
    breaches
}

/// A session that breaks SPEC while it resumes does not affect the other sessions.
//= SM2-SES-005, SM2-SES-006, SM2-RES-003 test
#[test]
fn a_violation_while_resuming_affects_no_other_session() {
    for (violation, bytes, fds) in breaches_while_resuming() {
        let mut scene = scene(Phase::Resuming);
        let mut left = scene.bench.clone();
        let events = offend(&mut scene, &bytes, fds);
        let goodbye = Event::HungUp(
            scene.offender,
            Some(violation.code()),
            Cause::Violation(violation),
        );
        assert_eq!(events, [goodbye], "{violation}");
        left.close(scene.offender);
        assert_eq!(left.manager, scene.bench.manager, "{violation}");
    }
}

/// Violations that take two frames.
//= SM2-WCH-001, SM2-CNT-001, SM2-RES-003 test
#[test]
fn a_violation_by_the_second_frame() {
    for (phase, rule, first, second) in [
        (
            Phase::Ready,
            violation!(CountersTwice, "SM2-CNT-001"),
            ToManagerKind::Counters,
            ToManagerKind::Counters,
        ),
        (
            Phase::Resuming,
            violation!(CountersTwice, "SM2-CNT-001"),
            ToManagerKind::Counters,
            ToManagerKind::Counters,
        ),
        (
            Phase::Resuming,
            violation!(BadClaim, "SM2-RES-003"),
            ToManagerKind::Claim,
            ToManagerKind::Claim,
        ),
        (
            Phase::Resuming,
            violation!(UnexpectedClaim, "SM2-RES-003"),
            ToManagerKind::Claimed,
            ToManagerKind::Claim,
        ),
    ] {
        let mut scene = scene(phase);
        assert!(scene.bench.is_known(scene.offender));
        send(&mut scene, first);
        assert!(scene.bench.is_known(scene.offender), "{first:?}");
        let events = send(&mut scene, second);
        let hung_up = Event::HungUp(scene.offender, Some(rule.code()), Cause::Violation(rule));
        assert_eq!(events.last(), Some(&hung_up), "{first:?} {second:?}");
    }
}

//= SM2-SES-005, SM2-SES-006, SM2-FRM-001, SM2-IFC-001, SM2-IFC-003, SM2-LNK-003 test
#[test]
fn a_violation_ends_its_session_alone() {
    let link = scene(Phase::Ready).link.expect("it is linked");
    for (violation, bytes, fds) in breaches(link) {
        let mut scene = scene(Phase::Ready);
        let mut left = scene.bench.clone();
        let events = offend(&mut scene, &bytes, fds);
        // The other end of its link is told once. Then the Manager closes the offender's
        // connection, once.
        let goodbye = Event::HungUp(
            scene.offender,
            Some(violation.code()),
            Cause::Violation(violation),
        );
        let told = Event::Sent(scene.publisher, unlink(1, link, 5));
        assert_eq!(events, [told.clone(), goodbye], "{violation}");
        // For all other sessions it is as if the offender had closed its connection.
        let gone = left.close(scene.offender);
        let gone_silently = Event::HungUp(scene.offender, None, Cause::Gone);
        assert_eq!(gone, [told, gone_silently]);
        assert_eq!(left.manager, scene.bench.manager, "{violation}");
    }
}

/// A node that breaks SPEC while it greets leaves no trace.
//= SM2-SES-005, SM2-SES-006 test
#[test]
fn a_violation_before_the_greeting_leaves_no_trace() {
    let link = scene(Phase::Ready).link.expect("it is linked");
    for (_, bytes, fds) in breaches(link) {
        let mut scene = scene(Phase::Greeting);
        let revision = scene.bench.manager.revision();
        let mut without = scene.bench.clone();
        let events = offend(&mut scene, &bytes, fds);
        if matches!(events[..], [Event::HungUp(..)]) {
            without.close(scene.offender);
            assert_eq!(without.manager, scene.bench.manager);
            assert_eq!(scene.bench.manager.revision(), revision);
        } else {
            // HELLO is the only legal frame here.
            assert!(matches!(
                events[..],
                [Event::Sent(_, ToNode::Welcome { .. })]
            ));
        }
    }
}

/// After the hang-up no datagram of the session is answered.
//= SM2-SES-005 test
#[test]
fn an_ended_session_is_not_answered() {
    let mut scene = scene(Phase::Ready);
    offend(&mut scene, &[16], 0);
    let before = scene.bench.manager.clone();
    for kind in TO_MANAGER_KINDS {
        assert_eq!(send(&mut scene, kind), [], "{kind:?}");
    }
    assert_eq!(scene.bench.close(scene.offender), []);
    assert_eq!(scene.bench.manager, before);
}

/// The rest of the honest pair's session does not depend on how the offender ended.
//= SM2-SES-006 test
#[test]
fn the_others_go_on_alike() {
    let goes_on = |scene: &mut Scene| {
        let mut seen = Vec::new();
        for frame in [
            ToManager::Query { after: None },
            withdraw(1),
            ToManager::Declare {
                interface: InterfaceId(2),
                contract: contract(),
            },
        ] {
            let events = scene.bench.send(scene.subscriber, &frame);
            seen.push(seen_by(&events, scene.subscriber));
            seen.push(seen_by(&events, scene.publisher));
        }
        seen
    };
    let mut compliant = scene(Phase::Ready);
    compliant.bench.close(compliant.offender);
    let compliant = goes_on(&mut compliant);
    let link = scene(Phase::Ready).link.expect("it is linked");
    for (violation, bytes, fds) in breaches(link) {
        let mut scene = scene(Phase::Ready);
        offend(&mut scene, &bytes, fds);
        assert_eq!(goes_on(&mut scene), compliant, "{violation}");
    }
}

//= SM2-TRN-004 test
#[test]
fn what_the_kernel_truncated_is_a_violation() {
    let violation = violation!(FrameTooLong, "SM2-TRN-004");
    let datagram = Datagram {
        data_truncated: true,
        control_truncated: true,
        ..Datagram::new(&[16])
    };
    let mut scene = scene(Phase::Greeting);
    let events = scene.bench.datagram(scene.offender, datagram);
    let hung_up = Event::HungUp(
        scene.offender,
        Some(violation.code()),
        Cause::Violation(violation),
    );
    assert_eq!(events, [hung_up]);
}
