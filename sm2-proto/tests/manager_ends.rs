//! The sessions that the Manager gives up, and the state that is left when a session or the Manager
//! ends.

use std::time::Duration;

use crate::support::{
    bench::{Bench, Event, UNLIMITED, hello, unlink, unlinked, withdraw},
    contracts::{scan, subscriber},
};
use sm2_proto::{
    Code, Farewell, Instant, Machine, NodeId, Refusal,
    control::{Limit, ToNode},
    manager::{Cause, Credentials, Input, Manager, Misuse},
};

//= SM2-TRN-008, SM2-SES-006 test
#[test]
fn a_session_that_does_not_read_is_given_up() {
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
fn the_policy_sets_the_time_to_greet() {
    for greeting_ms in [1_000, 60_000] {
        let limits = UNLIMITED.with(Limit::Greeting, greeting_ms);
        let (greeting, mut bench) = (limits.time(Limit::Greeting), Bench::new(limits));
        bench.connect(1);
        assert_eq!(bench.manager.deadline(), Some(bench.now.after(greeting)));
    }
}

//= SM2-SES-004 test
#[test]
fn a_connection_without_a_timely_greeting_is_given_up() {
    let mut bench = Bench::new(UNLIMITED);
    assert_eq!(bench.manager.deadline(), None);
    let start = bench.now;
    let first = bench.connect(1);
    let twin = bench.connect(1);
    bench.now = start.after(Duration::from_millis(500));
    let second = bench.connect(1);
    let third = bench.connect(1);
    let due = start.after(Duration::from_secs(2));
    assert_eq!(bench.manager.deadline(), Some(due));
    // A refusal does not extend the time to greet; a grant ends it.
    bench.hello(third, "third");
    let refused = ToNode::HelloRefused {
        reason: Refusal::NameTaken,
    };
    let refused = Event::Sent(second, refused);
    assert_eq!(bench.hello(second, "third"), [refused]);
    let before = Instant(due.0 - 1);
    bench.now = before;
    assert_eq!(bench.input(Input::Tick), []);
    let hung_up = |session| {
        let cause = Cause::Farewell(Farewell::GreetingTimeout);
        Event::HungUp(session, Some(Code(1)), cause)
    };
    bench.now = due;
    // A HELLO at the deadline is too late.
    let mut late = bench.clone();
    let both = [hung_up(first), hung_up(twin)];
    assert_eq!(late.hello(first, "first"), both);
    assert_eq!(bench.input(Input::Tick), both);
    let due = start.after(Duration::from_millis(2_500));
    assert_eq!(bench.manager.deadline(), Some(due));
    bench.now = due.after(Duration::from_secs(1));
    assert_eq!(bench.input(Input::Tick), [hung_up(second)]);
    assert_eq!(bench.manager.deadline(), None);
    assert!(bench.is_known(third));
}

/// Connections come and go, and no memory of them accumulates.
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

//= SM2-SES-007 test
#[test]
fn session_numbers_grow() {
    let mut manager = Manager::new(1, 7, UNLIMITED);
    let credentials = Credentials {
        uid: 1,
        gid: 1,
        pid: 1,
    };
    let mut connect = |session| {
        let session = NodeId(session);
        manager.handle(
            Instant(0),
            Input::Connected {
                session,
                credentials,
            },
        )
    };
    let misuse = |session| Err(Misuse::SessionNumber(NodeId(session)).into());
    assert_eq!(connect(0), misuse(0));
    assert_eq!(connect(5), Ok(()));
    assert_eq!(connect(5), misuse(5));
    assert_eq!(connect(4), misuse(4));
    assert_eq!(connect(6), Ok(()));
    assert_eq!(manager.sessions(), 2);
}

/// A misuse changes nothing, and does not even apply the time that has passed.
//= SM2-SES-007 test
#[test]
fn a_misuse_changes_nothing() {
    let mut bench = Bench::new(UNLIMITED);
    let session = bench.connect(1);
    let credentials = Credentials {
        uid: 1,
        gid: 1,
        pid: 1,
    };
    let before = bench.manager.clone();
    let connected = Input::Connected {
        session,
        credentials,
    };
    let late = bench.now.after(Duration::from_secs(60));
    let misuse = bench.manager.handle(late, connected);
    assert_eq!(misuse, Err(Misuse::SessionNumber(session).into()));
    assert_eq!(bench.manager, before);
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

//= SM2-RES-009 test
#[test]
fn only_standbys_are_told_early_of_a_hand_over() {
    let mut bench = Bench::new(UNLIMITED);
    let names = [
        "sm2/standby/7",
        "sm2/standby",
        "other/sm2/standby/7",
        "sm2/standby/7-2",
    ];
    let nodes = names.map(|name| bench.node(1, name));
    bench.connect(1);
    let hung_up = |session| {
        let cause = Cause::Farewell(Farewell::ShuttingDown);
        Event::HungUp(session, Some(Code(3)), cause)
    };
    let events = bench.input(Input::DismissStandbys);
    assert_eq!(events, [nodes[0], nodes[3]].map(hung_up));
    assert_eq!(bench.manager.sessions(), 3, "the others notice nothing");
    assert_eq!(bench.input(Input::DismissStandbys), []);
}

/// HELLO, DECLARE and all other frames of one session do not affect another one.
//= SM2-TRN-006, SM2-IFC-003 test
#[test]
fn interfaces_belong_to_their_session() {
    let mut bench = Bench::new(UNLIMITED);
    let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
    bench.declared(a, 1, &scan());
    let link = bench.declared(b, 2, &subscriber("scan", None))[0];
    for (frame, code) in [(withdraw(1), 36), (unlinked(1, link), 36), (hello("a"), 33)] {
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
