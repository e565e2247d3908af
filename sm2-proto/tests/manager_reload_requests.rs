//! RELOAD: a session has the access policy read again, and learns when it is applied.

use crate::support::{
    access::{access, banning, deny, finish_work, tables},
    bench::{Bench, Event, UNLIMITED, hello, seen_by},
    contracts::{data, publisher, subscriber},
};
use sm2_proto::{
    Farewell, NodeId,
    control::{PolicyProblem, ReloadOutcome, ToManager, ToNode},
    limits::RELOAD_TEXT_MAX,
    manager::{Cause, Input},
    policy::Action,
    violation,
};

const ROOT: u32 = 0;
const OWNER: u32 = 4;
const USER: u32 = 5;

fn bench() -> Bench {
    let mut bench = Bench::new(UNLIMITED);
    bench.manager = bench.manager.with_owner(OWNER);
    bench
}

fn reload(bench: &mut Bench, node: NodeId) -> Vec<Event> {
    bench.send(node, &ToManager::Reload)
}

const fn answer(node: NodeId, outcome: ReloadOutcome) -> Event {
    Event::Sent(node, ToNode::Reloaded { outcome })
}

//= SM2-ACC-017 test
#[test]
fn only_the_managers_user_and_root_may_ask() {
    let mut bench = bench();
    for (uid, name, may) in [(ROOT, "a", true), (OWNER, "b", true), (USER, "c", false)] {
        let node = bench.node(uid, name);
        let events = reload(&mut bench, node);
        match may {
            true => assert_eq!(events, [Event::PolicyWanted]),
            false => assert_eq!(events, [answer(node, ReloadOutcome::NotPermitted)]),
        }
    }
    // Without an owner, only root may.
    let mut bench = Bench::new(UNLIMITED);
    let (root, owner) = (bench.node(ROOT, "a"), bench.node(OWNER, "b"));
    assert_eq!(reload(&mut bench, root), [Event::PolicyWanted]);
    let refused = answer(owner, ReloadOutcome::NotPermitted);
    assert_eq!(reload(&mut bench, owner), [refused]);
}

//= SM2-ACC-016 test
#[test]
fn the_answer_comes_when_the_policy_is_applied() {
    let mut bench = bench();
    let (talker, listener) = (bench.node(USER, "talker"), bench.node(USER, "listener"));
    bench.declared(talker, 1, &publisher("a", &data("A")));
    let link = bench.declared(listener, 1, &subscriber("a", None))[0];
    let (tool, late) = (bench.node(OWNER, "tool"), bench.node(ROOT, "late"));
    assert_eq!(reload(&mut bench, tool), [Event::PolicyWanted]);
    let quiet = deny("quiet", Action::Publish, &["a"], &[]);
    bench.input(Input::SetAccessPolicy(access(tables(vec![quiet]))));
    let events = finish_work(&mut bench);
    assert_eq!(seen_by(&events, tool), []);
    bench.unlinked(talker, 1, link);
    // This policy was read before the second session asked: it does not answer the second one.
    assert_eq!(reload(&mut bench, late), [Event::PolicyWanted]);
    let applied = ReloadOutcome::Applied;
    bench.unlinked(listener, 1, link);
    let events = bench.suspended(talker, 1);
    assert_eq!(events, [answer(tool, applied.clone())]);
    bench.input(Input::SetAccessPolicy(None));
    assert_eq!(seen_by(&finish_work(&mut bench), late).len(), 1);
    // Each answer permits another question.
    assert_eq!(reload(&mut bench, tool), [Event::PolicyWanted]);
    assert_eq!(reload(&mut bench, late), [Event::PolicyWanted]);
    let events = bench.input(Input::SetAccessPolicy(access(tables(Vec::new()))));
    assert_eq!(events, []);
    let both = [tool, late].map(|it| answer(it, applied.clone()));
    assert_eq!(finish_work(&mut bench), both);
}

//= SM2-ACC-016 test
#[test]
fn what_cannot_be_used_is_said_and_changes_nothing() {
    let mut bench = bench();
    let (tool, waiting) = (bench.node(OWNER, "tool"), bench.node(OWNER, "waiting"));
    let talker = bench.node(USER, "talker");
    bench.declared(talker, 1, &publisher("a", &data("A")));
    let link = bench.declared(talker, 2, &subscriber("a", None))[0];
    reload(&mut bench, waiting);
    let quiet = deny("quiet", Action::Publish, &["a"], &[]);
    bench.input(Input::SetAccessPolicy(access(tables(vec![quiet]))));
    finish_work(&mut bench);
    reload(&mut bench, tool);
    // An umlaut does not fit behind the last byte but one.
    let mut text = "x".repeat(RELOAD_TEXT_MAX - 1);
    let problem = PolicyProblem::Invalid;
    let unusable = |text: &str| ReloadOutcome::Unusable {
        problem,
        text: text.to_owned(),
    };
    let expected = answer(tool, unusable(&text));
    text.push('ä');
    let events = bench.input(Input::AccessPolicyUnusable {
        problem,
        text: &text,
    });
    assert_eq!(events, [expected]);
    // The policy before goes on being applied.
    bench.unlinked(talker, 1, link);
    bench.unlinked(talker, 2, link);
    let events = bench.suspended(talker, 1);
    assert_eq!(events, [answer(waiting, ReloadOutcome::Applied)]);
    assert!(bench.manager.has_access_policy());
}

//= SM2-ACC-016 test
#[test]
fn a_domain_without_a_policy_says_so() {
    let mut bench = bench();
    let tool = bench.node(OWNER, "tool");
    reload(&mut bench, tool);
    let events = bench.input(Input::SetAccessPolicy(None));
    assert_eq!(events, [answer(tool, ReloadOutcome::NoPolicy)]);
    finish_work(&mut bench);
    // A domain that loses its policy applies that.
    bench.input(Input::SetAccessPolicy(access(tables(Vec::new()))));
    finish_work(&mut bench);
    reload(&mut bench, tool);
    bench.input(Input::SetAccessPolicy(None));
    let applied = answer(tool, ReloadOutcome::Applied);
    assert_eq!(finish_work(&mut bench), [applied]);
}

//= SM2-ACC-016 test
#[test]
fn a_session_that_the_policy_ends_is_answered_first() {
    let mut bench = bench();
    let (tool, other) = (bench.node(OWNER, "tool"), bench.node(USER, "other"));
    reload(&mut bench, tool);
    bench.input(Input::SetAccessPolicy(access(banning(&["*"]))));
    let denied = Cause::Farewell(Farewell::Denied);
    let end = |node| Event::HungUp(node, Some(Farewell::Denied.code()), denied);
    let applied = answer(tool, ReloadOutcome::Applied);
    assert_eq!(finish_work(&mut bench), [end(other), applied, end(tool)]);
    assert!(!bench.manager.is_applying_policy());
}

//= SM2-ACC-016 test
#[test]
fn one_question_at_a_time() {
    let mut bench = bench();
    for reads in [false, true] {
        let tool = bench.node(OWNER, "tool");
        reload(&mut bench, tool);
        if reads {
            bench.input(Input::SetAccessPolicy(access(tables(Vec::new()))));
        }
        let twice = violation!(ReloadTwice, "SM2-ACC-016");
        let hung_up = Event::HungUp(tool, Some(twice.code()), Cause::Violation(twice));
        assert_eq!(reload(&mut bench, tool), [hung_up]);
        // Nobody waits any more.
        bench.input(Input::SetAccessPolicy(access(tables(Vec::new()))));
        assert_eq!(finish_work(&mut bench), []);
    }
    // HELLO is the first frame of a session.
    let early = bench.connect(OWNER);
    let expected = violation!(ExpectedHello, "SM2-SES-001");
    let hung_up = Event::HungUp(early, Some(expected.code()), Cause::Violation(expected));
    assert_eq!(reload(&mut bench, early), [hung_up]);
    let node = bench.connect(OWNER);
    bench.send(node, &hello("late"));
    assert_eq!(reload(&mut bench, node), [Event::PolicyWanted]);
}
