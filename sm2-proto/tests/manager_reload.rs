//! Another access policy for a domain that runs: links end, sessions see other items, and what the
//! policy allows again comes back.

// Shows ACC-RELOAD (test).

use crate::support::{
    access::{access, banning, deny, finish_work, patterns, snapshot, tables},
    bench::{Bench, Event, UNLIMITED, claim, resuming, seen_by, unlink, unlinked},
    contracts::{data, name, publisher, subscriber},
};
use sm2_proto::{
    Farewell, Instant, InterfaceId, LinkId, Machine, NodeId, Refusal,
    control::{Item, Limit, ToManager, ToNode},
    manager::{Cause, Input},
    policy::{Action, Exclusive, Tables},
};

const USER: u32 = 5;
const DENIED: u16 = 7;

fn denied(rule: &str) -> Refusal {
    Refusal::Denied {
        rule: Some(name(rule)),
    }
}

fn refused(interface: u64, reason: Refusal) -> ToNode {
    let interface = InterfaceId(interface);
    ToNode::DeclareRefused { interface, reason }
}

fn granted(interface: u64) -> ToNode {
    ToNode::Declared {
        interface: InterfaceId(interface),
        matches: 0,
    }
}

fn reload(bench: &mut Bench, tables: Tables) -> Vec<Event> {
    let mut events = bench.input(Input::SetAccessPolicy(access(tables)));
    events.extend(finish_work(bench));
    events
}

/// A talker with interface 1 and a listener with interface 1, linked.
fn pair(bench: &mut Bench) -> (NodeId, NodeId, LinkId) {
    let (talker, listener) = (bench.node(USER, "talker"), bench.node(USER, "listener"));
    bench.declared(talker, 1, &publisher("a", &data("A")));
    let links = bench.declared(listener, 1, &subscriber("a", None));
    (talker, listener, links[0])
}

//= SM2-ACC-013, SM2-ACC-014 test
#[test]
fn a_denied_interface_loses_its_links_and_comes_back() {
    let mut bench = Bench::new(UNLIMITED);
    let (talker, listener, link) = pair(&mut bench);
    let rule = || deny("quiet", Action::Publish, &["a"], &[]);
    let events = reload(&mut bench, tables(vec![rule()]));
    let told = [refused(1, denied("quiet")), unlink(1, link, DENIED)];
    assert_eq!(seen_by(&events, talker), told);
    assert_eq!(seen_by(&events, listener), [unlink(1, link, DENIED)]);
    // The rule is shown, so that `why` can name it.
    let all = snapshot(&mut bench, listener);
    let refusal = all.values().find(|it| matches!(it, Item::Refusal { .. }));
    assert!(
        matches!(refusal, Some(Item::Refusal { reason, .. }) if *reason == denied("quiet")),
        "{all:?}"
    );
    // It is applied once both sides have confirmed.
    assert_eq!(bench.suspended(talker, 1), []);
    assert!(bench.manager.is_applying_policy());
    bench.unlinked(talker, 1, link);
    assert!(bench.manager.is_applying_policy());
    bench.unlinked(listener, 1, link);
    assert!(!bench.manager.is_applying_policy());
    assert_eq!(bench.manager.deadline(), None);
    // A subscriber that comes now is not linked, and neither is another publisher.
    let late = bench.node(USER, "late");
    assert_eq!(bench.declared(late, 1, &subscriber("a", None)), []);
    let events = bench.declare(late, 2, &publisher("a", &data("A")));
    assert_eq!(seen_by(&events, late), [refused(2, denied("quiet"))]);
    // The same denial is not repeated; another one is.
    assert_eq!(reload(&mut bench, tables(vec![rule()])), []);
    let other = deny("silent", Action::Publish, &["*"], &[]);
    let events = reload(&mut bench, tables(vec![other]));
    assert_eq!(events, [Event::Sent(talker, refused(1, denied("silent")))]);
    assert!(bench.manager.is_applying_policy());
    bench.suspended(talker, 1);
    let events = reload(&mut bench, tables(Vec::new()));
    assert_eq!(seen_by(&events, talker)[0], granted(1));
    assert_eq!(bench.manager.links(), 2);
    assert!(!bench.manager.is_applying_policy());
}

/// Without a policy, sessions are known as well, so that a policy can judge them later.
//= SM2-ACC-013, SM2-ACC-010 test
#[test]
fn sessions_see_other_items_at_once() {
    let mut bench = Bench::new(UNLIMITED);
    let (talker, listener, _) = pair(&mut bench);
    let before = snapshot(&mut bench, listener);
    let after = bench.manager.revision();
    bench.send(listener, &ToManager::Watch { after });
    let hidden = deny("hidden", Action::See, &["talker"], &["listener"]);
    let events = reload(&mut bench, tables(vec![hidden]));
    // The changes are not remembered: only pages tell what is gone.
    let told = seen_by(&events, listener);
    assert!(
        matches!(&told[..], [ToNode::Changes(it)] if it.changes.is_none() && it.revision > after),
        "{told:?}"
    );
    let shown = snapshot(&mut bench, listener);
    assert!(shown.len() < before.len());
    let of_talker = |it: &Item| matches!(it, Item::Node { node, .. } if *node == talker);
    assert!(!shown.values().any(of_talker), "{shown:?}");
    // The same policy again hides nothing new.
    let revision = bench.manager.revision();
    let hidden = deny("hidden", Action::See, &["talker"], &["listener"]);
    reload(&mut bench, tables(vec![hidden]));
    assert_eq!(bench.manager.revision(), revision);
    bench.input(Input::SetAccessPolicy(None));
    finish_work(&mut bench);
    assert_eq!(snapshot(&mut bench, listener), before);
}

//= SM2-ACC-013 test
#[test]
fn an_exclusive_topic_keeps_the_publisher_that_came_first() {
    let exclusive = |rules| Tables {
        exclusive: vec![Exclusive {
            name: name("motion"),
            topics: patterns(&["a"]),
        }],
        ..tables(rules)
    };
    let mut bench = Bench::new(UNLIMITED);
    let [first, second, third] = ["first", "second", "third"].map(|it| bench.node(USER, it));
    for node in [third, first, second] {
        bench.declared(node, 1, &publisher("a", &data("A")));
    }
    let reason = Refusal::Exclusive {
        rule: name("motion"),
    };
    let events = reload(&mut bench, exclusive(Vec::new()));
    let lose = |node| Event::Sent(node, refused(1, reason.clone()));
    assert_eq!(events, [lose(second), lose(third)]);
    // If the policy denies the first one, the next one gets the topic.
    let rule = || deny("not-first", Action::Publish, &["a"], &["first"]);
    let events = reload(&mut bench, exclusive(vec![rule()]));
    let expected = [
        Event::Sent(first, refused(1, denied("not-first"))),
        Event::Sent(second, granted(1)),
    ];
    assert_eq!(events, expected);
    // It keeps the topic when the first one is allowed again.
    assert_eq!(reload(&mut bench, exclusive(Vec::new())), [lose(first)]);
}

//= SM2-ACC-014 test
#[test]
fn a_node_that_does_not_confirm_is_ended() {
    let limits = UNLIMITED.with(Limit::Confirmation, 7_000);
    let (confirmation, mut bench) = (limits.time(Limit::Confirmation), Bench::new(limits));
    let (talker, listener, link) = pair(&mut bench);
    reload(
        &mut bench,
        tables(vec![deny("deaf", Action::Subscribe, &["a"], &[])]),
    );
    bench.unlinked(listener, 1, link);
    bench.suspended(listener, 1);
    let until = bench.now.after(confirmation);
    bench.now = Instant(until.0 - 1);
    assert_eq!(finish_work(&mut bench), []);
    bench.now = until;
    let stalled = Cause::Farewell(Farewell::Stalled);
    let code = Some(Farewell::Stalled.code());
    let events = finish_work(&mut bench);
    assert_eq!(events, [Event::HungUp(talker, code, stalled)]);
    assert!(!bench.manager.is_applying_policy());
    // WITHDRAW and the end of the session confirm as well.
    for leaves in [false, true] {
        let mut bench = Bench::new(UNLIMITED);
        let (talker, listener, link) = pair(&mut bench);
        reload(
            &mut bench,
            tables(vec![deny("deaf", Action::Subscribe, &["a"], &[])]),
        );
        bench.unlinked(listener, 1, link);
        bench.suspended(listener, 1);
        assert!(bench.manager.is_applying_policy());
        drop(match leaves {
            false => bench.withdraw(talker, 1),
            true => bench.close(talker),
        });
        assert!(!bench.manager.is_applying_policy());
        bench.now = bench.now.after(UNLIMITED.time(Limit::Confirmation));
        assert_eq!(finish_work(&mut bench), []);
    }
}

/// A suspended interface without links is confirmed as well, because messages of links that ended
/// before may wait in its node. Each suspension is confirmed for itself.
//= SM2-ACC-014 test
#[test]
fn an_interface_without_links_confirms_each_suspension() {
    let rules = || tables(vec![deny("deaf", Action::Subscribe, &["a"], &[])]);
    let stalled = Cause::Farewell(Farewell::Stalled);
    for leaves in [None, Some(false), Some(true)] {
        let mut bench = Bench::new(UNLIMITED);
        let listener = bench.node(USER, "listener");
        bench.declared(listener, 1, &subscriber("a", None));
        for policy in [rules(), tables(Vec::new()), rules()] {
            reload(&mut bench, policy);
        }
        bench.suspended(listener, 1);
        assert!(bench.manager.is_applying_policy());
        drop(match leaves {
            None => bench.suspended(listener, 1),
            Some(false) => bench.withdraw(listener, 1),
            Some(true) => bench.close(listener),
        });
        assert!(!bench.manager.is_applying_policy());
        assert_eq!(bench.manager.deadline(), None);
    }
    let mut bench = Bench::new(UNLIMITED);
    let listener = bench.node(USER, "listener");
    bench.declared(listener, 1, &subscriber("a", None));
    reload(&mut bench, rules());
    bench.now = bench.now.after(UNLIMITED.time(Limit::Confirmation));
    let ended = Event::HungUp(listener, Some(Farewell::Stalled.code()), stalled);
    assert_eq!(finish_work(&mut bench), [ended]);
}

//= SM2-ACC-013 test
#[test]
fn a_denied_name_ends_the_session_after_its_links() {
    let mut bench = Bench::new(UNLIMITED);
    let (talker, listener, link) = pair(&mut bench);
    let silent = bench.node(USER, "talker/two");
    let events = reload(&mut bench, banning(&["talker", "talker/*"]));
    let denial = Cause::Farewell(Farewell::Denied);
    let end = |node| Event::HungUp(node, Some(Farewell::Denied.code()), denial);
    assert_eq!(events.last(), Some(&end(silent)), "it has no links");
    let told = [refused(1, denied("nobody")), unlink(1, link, DENIED)];
    assert_eq!(seen_by(&events, talker), told);
    let declared = bench.declare(talker, 2, &publisher("b", &data("B")));
    assert_eq!(seen_by(&declared, talker), [refused(2, denied("nobody"))]);
    assert_eq!(bench.unlinked(listener, 1, link), []);
    assert_eq!(bench.unlinked(talker, 1, link), []);
    assert_eq!(finish_work(&mut bench), []);
    bench.suspended(talker, 1);
    assert_eq!(finish_work(&mut bench), [end(talker)]);
    assert!(!bench.manager.is_applying_policy());
    let again = bench.connect(USER);
    let refusal = ToNode::HelloRefused {
        reason: denied("nobody"),
    };
    assert_eq!(seen_by(&bench.hello(again, "talker"), again), [refusal]);
}

/// A node comes back with an interface that the policy of this Manager denies.
//= SM2-RES-010, SM2-ACC-014 test
#[test]
fn a_renewed_interface_that_is_denied_stays_suspended() {
    let policy = UNLIMITED.with(Limit::InterfacesPerSession, 1);
    let mut bench = Bench::new(policy);
    let quiet = || tables(vec![deny("quiet", Action::Publish, &["a"], &[])]);
    reload(&mut bench, quiet());
    let listener = bench.node(USER, "listener");
    bench.declared(listener, 1, &subscriber("a", None));
    let node = bench.connect(USER);
    bench.send(node, &resuming("talker"));
    let contract = publisher("a", &data("A"));
    let answer = |bench: &mut Bench, number| bench.declare(node, number, &contract);
    let events = answer(&mut bench, 1);
    assert_eq!(seen_by(&events, node), [refused(1, denied("quiet"))]);
    // It counts: beyond a quota, the quota is the reason, and the Manager does not keep it.
    let events = answer(&mut bench, 2);
    assert!(
        matches!(&seen_by(&events, node)[..], [ToNode::DeclareRefused { reason, .. }] if !reason.is_denial()),
        "{events:?}"
    );
    // A claim that was under way is answered.
    let old = LinkId {
        epoch: 3,
        serial: 4,
    };
    let events = bench.send(node, &claim(1, old, 9));
    assert_eq!(seen_by(&events, node), [unlink(1, old, DENIED)]);
    bench.send(node, &unlinked(1, old));
    bench.send(node, &ToManager::Claimed);
    assert_eq!(finish_work(&mut bench), []);
    let events = reload(&mut bench, tables(Vec::new()));
    assert!(
        matches!(&seen_by(&events, node)[..], [first, ToNode::Link { .. }] if *first == granted(1)),
        "{events:?}"
    );
    reload(&mut bench, quiet());
    let events = bench.withdraw(node, 1);
    let interface = InterfaceId(1);
    assert!(seen_by(&events, node).contains(&ToNode::Withdrawn { interface }));
}

/// One part of the work makes or ends only a few links, whatever the number of interfaces.
//= SM2-SES-009, SM2-ACC-013 test
#[test]
fn a_reload_is_done_in_parts() {
    let policy = UNLIMITED.with(Limit::WorkPerTurn, 512);
    let mut bench = Bench::new(policy);
    let (talker, listener) = (bench.node(USER, "talker"), bench.node(USER, "listener"));
    for number in 1..=400 {
        let topic = format!("a/{number}");
        bench.declared(talker, number, &publisher(&topic, &data("A")));
        bench.declared(listener, number, &subscriber(&topic, None));
    }
    for (rules, frames) in [
        (vec![deny("quiet", Action::Publish, &["a/*"], &[])], 1_200),
        (Vec::new(), 1_200),
    ] {
        let mut parts = vec![bench.input(Input::SetAccessPolicy(access(tables(rules))))];
        while bench.manager.deadline().is_some_and(|at| at <= bench.now) {
            parts.push(bench.input(Input::Tick));
        }
        let sent = |part: &Vec<Event>| {
            [talker, listener]
                .map(|it| seen_by(part, it).len())
                .iter()
                .sum()
        };
        let sent: Vec<usize> = parts.iter().map(sent).collect();
        assert_eq!(sent.iter().sum::<usize>(), frames);
        assert!(sent.iter().all(|&it| it <= 60), "{sent:?}");
    }
}
