//! The counters and the texts of types that nodes hand to the Manager, and that other nodes ask
//! for.

use crate::support::{
    bench::{Bench, Event, UNLIMITED},
    contracts::name,
};
use sm2_proto::{
    Datagram, FdFacts, NodeId, Seals, TypeId, Violation,
    control::{Limit, SchemaText, ToManager, ToNode, encode_to_manager},
    limits::SCHEMA_TEXT_MAX,
    manager::{Cause, Input},
    schema::Schema,
    violation,
};

const COUNTERS: FdFacts = FdFacts {
    regular: true,
    size_bytes: 1_024,
    seals: Seals::POOLED,
};

fn hand_over(bench: &mut Bench, node: NodeId, file: FdFacts) -> Vec<Event> {
    let bytes = encode_to_manager(&ToManager::Counters);
    let datagram = Datagram {
        fds: &[file],
        ..Datagram::new(&bytes)
    };
    bench.datagram(node, datagram)
}

fn hung_up(node: NodeId, rule: Violation) -> Event {
    Event::HungUp(node, Some(rule.code()), Cause::Violation(rule))
}

//= SM2-CNT-001, SM2-CNT-003 test
#[test]
fn counters_are_kept_and_handed_on() {
    let mut bench = Bench::new(UNLIMITED);
    let (a, b) = (bench.node(1, "a"), bench.node(2, "b"));
    let inspect = |bench: &mut Bench, of| bench.send(b, &ToManager::Inspect { node: of });
    let none = |of| Event::Sent(b, ToNode::NotInspected { node: of });
    // INSPECT of a node without counters, of the asking node itself, and of a number without a
    // node.
    for of in [a, b, NodeId(0), NodeId(99)] {
        assert_eq!(inspect(&mut bench, of), [none(of)]);
    }
    let revision = bench.manager.revision();
    assert_eq!(hand_over(&mut bench, a, COUNTERS), [Event::CountersKept(a)]);
    assert_eq!(bench.manager.revision(), revision);
    let answer = Event::CountersSent(b, ToNode::Inspected { node: a }, a);
    for _ in 0..2 {
        assert_eq!(inspect(&mut bench, a), std::slice::from_ref(&answer));
    }
    assert_eq!(inspect(&mut bench, b), [none(b)]);
    // A connection that has not greeted has no counters either.
    let greeting = bench.connect(1);
    assert_eq!(inspect(&mut bench, greeting), [none(greeting)]);
    bench.close(a);
    assert_eq!(inspect(&mut bench, a), [none(a)]);
}

//= SM2-CNT-001, SM2-CNT-004 test
#[test]
fn files_that_are_no_counters() {
    let with = |size_bytes| FdFacts {
        size_bytes,
        ..COUNTERS
    };
    let sealed = |seals| FdFacts { seals, ..COUNTERS };
    let pooled = Seals::POOLED.0;
    let mut bad = vec![(
        violation!(NotAMemfd, "SM2-CNT-001"),
        FdFacts {
            regular: false,
            ..COUNTERS
        },
    )];
    for bit in [1, 2, 4, 16] {
        bad.push((
            violation!(SealsMissing, "SM2-CNT-001"),
            sealed(Seals(pooled & !bit)),
        ));
    }
    for size in [0, 512, 1_023, 1_025, 1_536 + 8, 4_194_304 + 512, u64::MAX] {
        bad.push((violation!(BadSize, "SM2-CNT-001"), with(size)));
    }
    // The first check that fails names the violation.
    bad.push((violation!(NotAMemfd, "SM2-CNT-001"), FdFacts::default()));
    bad.push((
        violation!(SealsMissing, "SM2-CNT-001"),
        FdFacts {
            seals: Seals(0),
            ..with(0)
        },
    ));
    let mut bench = Bench::new(UNLIMITED);
    let node = bench.node(1, "a");
    for (rule, file) in bad {
        let events = hand_over(&mut bench.clone(), node, file);
        assert_eq!(events, [hung_up(node, rule)], "{file:?}");
    }
    for file in [with(1_536), with(4_194_304), sealed(Seals(0x1f))] {
        let events = hand_over(&mut bench.clone(), node, file);
        assert_eq!(events, [Event::CountersKept(node)], "{file:?}");
    }
    // COUNTERS is legal once, so a second one is a violation whatever descriptor it carries.
    hand_over(&mut bench, node, COUNTERS);
    for file in [COUNTERS, FdFacts::default()] {
        let events = hand_over(&mut bench.clone(), node, file);
        assert_eq!(
            events,
            [hung_up(node, violation!(CountersTwice, "SM2-CNT-001"))]
        );
    }
    // COUNTERS carries exactly one descriptor.
    for fds in [0, 2] {
        let bytes = encode_to_manager(&ToManager::Counters);
        let datagram = Datagram {
            fds: &vec![COUNTERS; fds],
            ..Datagram::new(&bytes)
        };
        let events = bench.clone().datagram(node, datagram);
        assert_eq!(events, [hung_up(node, violation!(FdCount, "SM2-TRN-010"))]);
    }
}

fn typed(text: &str, name_text: &str) -> TypeId {
    TypeId {
        name: name(name_text),
        hash: Schema::parse(text).expect("a schema").hash(),
    }
}

fn register(bench: &mut Bench, node: NodeId, data: &TypeId, text: &str) -> Vec<Event> {
    let (data, text) = (data.clone(), text.to_owned());
    bench.send(node, &ToManager::Schema(SchemaText { data, text }))
}

/// The Manager's answers about types.
fn described(bench: &mut Bench, node: NodeId, data: &TypeId) -> Option<String> {
    let frame = ToManager::Describe { data: data.clone() };
    let events = bench.send(node, &frame);
    match &events[..] {
        [Event::Sent(to, ToNode::Described { data: of, text })] => {
            assert_eq!((*to, of), (node, data));
            text.clone()
        }
        other => panic!("{other:?}"),
    }
}

const POSE: &str = "postcard:struct{x:f64,y:f64,}";

//= SM2-SCH-001, SM2-SCH-002 test
#[test]
fn texts_live_as_long_as_a_session_that_registered_them() {
    let mut bench = Bench::new(UNLIMITED);
    let (a, b, c) = (bench.node(1, "a"), bench.node(2, "b"), bench.node(1, "c"));
    let pose = typed(POSE, "Pose");
    assert_eq!(described(&mut bench, c, &pose), None);
    let revision = bench.manager.revision();
    for node in [a, b, a] {
        assert_eq!(register(&mut bench, node, &pose, POSE), []);
    }
    assert_eq!(bench.manager.revision(), revision);
    // Name and hash together identify a type.
    let namesake = TypeId {
        hash: pose.hash + 1,
        ..pose.clone()
    };
    assert_eq!(described(&mut bench, c, &namesake), None);
    assert_eq!(described(&mut bench, c, &typed(POSE, "Other")), None);
    for last in [a, b] {
        assert_eq!(described(&mut bench, c, &pose).as_deref(), Some(POSE));
        bench.close(last);
    }
    assert_eq!(described(&mut bench, c, &pose), None);
}

//= SM2-SCH-001 test
#[test]
fn texts_that_are_not_the_types() {
    let mut bench = Bench::new(UNLIMITED);
    let node = bench.node(1, "a");
    let pose = typed(POSE, "Pose");
    let other = TypeId {
        hash: pose.hash ^ 1,
        ..pose.clone()
    };
    let long = format!("{POSE}{}", " ".repeat(SCHEMA_TEXT_MAX));
    for (data, text) in [
        (&other, POSE),
        (&pose, "postcard:struct{x:f64,y:f32,}"),
        (&pose, ""),
        (&pose, "postcard:struct{x:f64,y:f64,"),
        (&pose, &long),
    ] {
        let events = register(&mut bench.clone(), node, data, text);
        assert_eq!(
            events,
            [hung_up(node, violation!(BadSchema, "SM2-SCH-001"))],
            "{text}"
        );
    }
}

//= SM2-SCH-001 test
#[test]
fn texts_beyond_the_quota_are_not_kept() {
    let (first, second) = (typed(POSE, "First"), typed(POSE, "Second"));
    let cost = POSE.len() + "First".len();
    for (schema_bytes_per_session, kept) in
        [(cost - 1, 0), (cost, 1), (2 * cost, 1), (2 * cost + 1, 2)]
    {
        let quota = u32::try_from(schema_bytes_per_session).expect("a small number");
        let mut bench = Bench::new(UNLIMITED.with(Limit::SchemaBytesPerSession, quota));
        let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
        for data in [&first, &first, &second] {
            assert_eq!(register(&mut bench, a, data, POSE), [], "no violation");
        }
        let found = [&first, &second].map(|data| described(&mut bench, b, data).is_some());
        assert_eq!(found, [kept > 0, kept > 1]);
        // Each session has its own registrations.
        register(&mut bench, b, &first, POSE);
        assert_eq!(
            described(&mut bench, b, &first).is_some(),
            schema_bytes_per_session >= cost
        );
        bench.close(a);
        assert!(described(&mut bench, b, &second).is_none());
    }
}

/// No text is left once all sessions are gone. The machine's invariants check the rest.
//= SM2-CNT-001, SM2-SCH-001, SM2-SES-006 test
#[test]
fn nothing_is_left() {
    let mut bench = Bench::new(UNLIMITED);
    let node = bench.node(1, "a");
    hand_over(&mut bench, node, COUNTERS);
    register(&mut bench, node, &typed(POSE, "Pose"), POSE);
    bench.send(
        node,
        &ToManager::Watch {
            after: bench.manager.revision(),
        },
    );
    bench.input(Input::Shutdown);
    let next = bench.node(1, "b");
    assert_eq!(described(&mut bench, next, &typed(POSE, "Pose")), None);
}
