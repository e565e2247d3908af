//! Queries about the domain.

use crate::common;

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

use common::{Domain, SOON, away, back, until};
use sm2_node::domain::{Change, Domain as Mirror, EntityId, Finding, Item, Key};
use sm2_node::{Message, Node, TypeId};

fn names(domain: &Mirror) -> Vec<String> {
    domain.nodes().map(|node| node.name.to_string()).collect()
}

/// Returns the topics of interfaces that were not refused.
fn topics(domain: &Mirror) -> Vec<String> {
    let granted = domain.interfaces().filter(|it| it.refused.is_none());
    granted.map(|it| it.contract.name().to_string()).collect()
}

//= SM2-WCH-003 test
#[test]
fn a_snapshot_shows_what_was_declared_before() {
    let domain = Domain::new();
    let node = domain.node("node");
    assert_eq!(names(&node.snapshot().unwrap()), ["node"]);
    let mut all = Vec::new();
    // More items than one page holds.
    for count in 0..400 {
        let name = format!("{}/{count:03}", "long-name".repeat(20));
        all.push(node.publisher::<[u8]>(&name).unwrap());
    }
    let snapshot = node.snapshot().unwrap();
    assert_eq!(topics(&snapshot).len(), 400);
    assert!(snapshot.limits().is_some());
    all.truncate(10);
    until(|| topics(&node.snapshot().unwrap()).len() == 10);
}

//= SM2-WCH-003 test
#[test]
fn snapshots_are_exact_while_everything_changes() {
    let domain = Domain::new();
    let stop = AtomicBool::new(false);
    let tool = domain.node("tool");
    // Every snapshot must contain these, which exist during the whole test.
    let steady: Vec<_> = (0..150)
        .map(|n| {
            tool.publisher::<[u8]>(&format!("steady/{}/{n}", "x".repeat(220)))
                .unwrap()
        })
        .collect();
    thread::scope(|scope| {
        for churner in 0..2 {
            let (node, stop) = (domain.node(&format!("churner-{churner}")), &stop);
            scope.spawn(move || {
                while !stop.load(Ordering::Relaxed) {
                    // Each pair exists as a whole or not at all, except for one moment.
                    let one = node.publisher::<[u8]>("churn").unwrap();
                    let other = node.subscriber::<[u8]>("churn").unwrap();
                    drop((one, other));
                }
            });
        }
        let readers: Vec<_> = (0..3)
            .map(|_| {
                scope.spawn(|| {
                    let mut last = 0;
                    for _ in 0..20 {
                        let snapshot = tool.snapshot().unwrap();
                        assert!(snapshot.revision() >= last);
                        last = snapshot.revision();
                        let shown = topics(&snapshot);
                        let kept = shown.iter().filter(|it| it.starts_with("steady")).count();
                        assert_eq!(kept, steady.len());
                        // A link exists only between interfaces that exist.
                        for link in snapshot.links() {
                            assert!(snapshot.interface(link.offering).is_some());
                            assert!(snapshot.interface(link.demanding).is_some());
                        }
                        for node in snapshot.nodes() {
                            assert!(snapshot.interfaces_of(node.node).count() <= steady.len());
                        }
                    }
                })
            })
            .collect();
        let failed = readers.into_iter().filter_map(|it| it.join().err()).count();
        stop.store(true, Ordering::Relaxed);
        assert_eq!(failed, 0);
    });
}

/// The state that results from a watch's changes.
#[derive(Default)]
struct Told(BTreeMap<Key, Item>);

impl Told {
    fn take(&mut self, changes: Vec<Change>) {
        for change in changes {
            match change {
                Change::Set { item } => drop(self.0.insert(item.key(), item)),
                Change::Removed { key } => assert!(self.0.remove(&key).is_some(), "{key:?}"),
            }
        }
    }

    fn is(&self, domain: &Mirror) -> bool {
        self.0.values().eq(domain.items())
    }
}

//= SM2-WCH-001, SM2-WCH-003 test
#[test]
fn a_watch_sees_every_change_also_that_of_the_manager() {
    let mut domain = Domain::new();
    let tool = domain.node("tool");
    let node = domain.node("node");
    // A node states its room for links after it is welcomed.
    until(|| {
        let snapshot = tool.snapshot().unwrap();
        snapshot.nodes().all(|it| it.max_links.is_some())
    });
    let mut watch = tool.watch();
    let mut told = Told::default();
    assert_eq!(watch.domain().items().count(), 0);
    told.take(watch.wait_timeout(SOON).unwrap());
    assert!(told.is(watch.domain()) && told.is(&tool.snapshot().unwrap()));
    // Nothing else has changed: the next change is that of the next publisher.
    let marker = node.publisher::<u8>("marker").unwrap();
    let changes = watch.wait_timeout(SOON).unwrap();
    let is_marker = |it: &Change| {
        matches!(it, Change::Set { item: Item::Interface { contract, .. } }
            if contract.name().as_str() == "marker")
    };
    assert!(changes.len() == 1 && is_marker(&changes[0]), "{changes:?}");
    told.take(changes);
    drop(marker);
    told.take(watch.wait_timeout(SOON).unwrap());
    for round in 0..50 {
        let publisher = node.publisher::<u8>(&format!("topic/{round}")).unwrap();
        told.take(watch.wait_timeout(SOON).unwrap());
        assert!(
            told.is(watch.domain()) && told.is(&tool.snapshot().unwrap()),
            "round {round}"
        );
        drop(publisher);
        told.take(watch.wait_timeout(SOON).unwrap());
        assert!(
            told.is(watch.domain()) && told.is(&tool.snapshot().unwrap()),
            "round {round}"
        );
    }
    let _kept = node.publisher::<u8>("kept").unwrap();
    domain.stop();
    away(&[&tool, &node]);
    // The watch reports the changes until the Manager ended, and no more.
    while let changes = watch.wait_timeout(Duration::from_millis(2)).unwrap()
        && !changes.is_empty()
    {
        told.take(changes);
    }
    assert!(told.is(watch.domain()));
    domain.start();
    back(&[&tool, &node]);
    until(|| {
        told.take(watch.wait_timeout(Duration::from_millis(2)).unwrap());
        assert!(told.is(watch.domain()));
        told.is(&tool.snapshot().unwrap())
    });
    assert_eq!(topics(watch.domain()), ["kept"]);
}

#[test]
fn several_watches_and_questions_of_one_node_do_not_wait_for_each_other() {
    let domain = Domain::new();
    let tool = domain.node("tool");
    let node = domain.node("node");
    let mut early = tool.watch();
    early.wait_timeout(SOON).unwrap();
    let mut late = tool.watch();
    late.wait_timeout(SOON).unwrap();
    let publisher = node.publisher::<u8>("one").unwrap();
    // This watch continues and then waits for changes; the other one is behind.
    assert!(!late.wait_timeout(SOON).unwrap().is_empty());
    thread::scope(|scope| {
        let ahead = scope.spawn(|| late.wait_timeout(SOON).unwrap());
        for _ in 0..20 {
            assert_eq!(topics(&tool.snapshot().unwrap()), ["one"]);
            assert!(
                tool.describe(&TypeId::clone(&u8::type_id()))
                    .unwrap()
                    .is_some()
            );
        }
        assert!(!early.wait_timeout(SOON).unwrap().is_empty());
        assert_eq!(topics(early.domain()), ["one"]);
        drop(publisher);
        assert!(!ahead.join().unwrap().is_empty());
    });
    assert!(topics(late.domain()).is_empty());
}

/// A watch in the middle of its pages needs changes that another watch's query does not return.
#[test]
fn a_watch_that_waits_at_the_end_does_not_hold_up_one_in_the_middle() {
    let domain = Domain::new();
    let tool = domain.node("tool");
    let many: Vec<_> = (0..600)
        .map(|n| {
            tool.publisher::<[u8]>(&format!("{}/{n}", "x".repeat(240)))
                .unwrap()
        })
        .collect();
    // Each step reads at most one page.
    let mut early = tool.watch();
    for _ in 0..2 {
        assert!(early.try_wait().unwrap().is_empty());
        thread::sleep(Duration::from_millis(2));
    }
    let one_more = tool.publisher::<u8>("one-more").unwrap();
    let mut late = tool.watch();
    assert_eq!(late.wait_timeout(SOON).unwrap().len(), many.len() + 3);
    // From here on the watch waits for later changes.
    assert!(late.try_wait().unwrap().is_empty());
    assert_eq!(early.wait_timeout(SOON).unwrap().len(), many.len() + 3);
    drop(one_more);
}

/// Changes of a new Manager must not be applied to the state of the old one, whatever their revisions.
#[test]
fn a_watch_that_was_not_asked_during_the_change_is_exact_after_it() {
    let mut domain = Domain::new();
    let (tool, node, gone) = (
        domain.node("tool"),
        domain.node("node"),
        domain.node("gone"),
    );
    // A revision that the next Manager will reach too.
    for _ in 0..20 {
        drop(node.publisher::<u8>("topic").unwrap());
    }
    let mut early = tool.watch();
    let mut told = Told::default();
    told.take(early.wait_timeout(SOON).unwrap());
    assert!(early.try_wait().unwrap().is_empty());
    domain.stop();
    away(&[&tool, &node]);
    drop(gone);
    domain.start();
    back(&[&tool, &node]);
    let mut late = tool.watch();
    late.wait_timeout(SOON).unwrap();
    while late.domain().revision() <= early.domain().revision() + 5 {
        let _publisher = node.publisher::<u8>("topic").unwrap();
        late.wait_timeout(SOON).unwrap();
    }
    until(|| topics(&tool.snapshot().unwrap()).is_empty());
    // The change of Manager is one step: no state contains items of both Managers.
    told.take(early.wait_timeout(SOON).unwrap());
    assert!(told.is(early.domain()) && told.is(&tool.snapshot().unwrap()));
    assert_eq!(names(early.domain()).len(), 2);
}

/// A watch also works for a program that never waits.
#[test]
fn a_watch_that_is_only_polled_sees_changes() {
    let domain = Domain::new();
    let tool = domain.node("tool");
    let mut watch = tool.watch();
    until(|| !watch.try_wait().unwrap().is_empty());
    let _publisher = domain.node("node").publisher::<u8>("topic").unwrap();
    until(|| {
        watch.try_wait().unwrap();
        topics(watch.domain()) == ["topic"]
    });
}

fn entity(node: &Node, domain: &Mirror, kind: sm2_node::domain::Kind) -> EntityId {
    let mut found = domain.interfaces_of(node.id().unwrap());
    found.find(|it| it.contract.kind() == kind).unwrap().entity
}

//= SM2-MAT-001, SM2-WCH-004 test
#[test]
fn why_says_what_is_linked_and_what_is_not() {
    let domain = Domain::new();
    let (talker, listener) = (domain.node("talker"), domain.node("listener"));
    let publisher = talker.publisher::<u8>("topic").unwrap();
    let subscriber = listener.subscriber::<u8>("topic").unwrap();
    let demanding = listener.subscriber_builder::<u8>("topic").reliable(true);
    let demanding = demanding.declare().unwrap();
    let snapshot = listener.snapshot().unwrap();
    let offers = entity(&talker, &snapshot, sm2_node::domain::Kind::Publisher);
    let takes = entity(&listener, &snapshot, sm2_node::domain::Kind::Subscriber);
    let verdict = listener.why(takes, offers).unwrap();
    assert!(verdict.is_linked(), "{verdict:?}");
    let near = demanding.why().unwrap();
    assert_eq!(near.len(), 1, "{near:?}");
    let near = format!("{near:?}");
    assert!(near.contains("eliab"), "{near}");
    let gone = EntityId {
        interface: sm2_node::domain::InterfaceId(99),
        ..offers
    };
    let verdict = talker.why(takes, gone).unwrap();
    assert!(
        matches!(verdict.finding, Finding::Unknown { .. }),
        "{verdict:?}"
    );
    // A topic with a similar name, and a service.
    let alone = listener.subscriber::<u8>("topics").unwrap();
    assert!(!alone.why().unwrap().is_empty());
    assert!(publisher.why().is_ok() && subscriber.is_registered());
    let server = talker.server::<u8, u8>("add").unwrap();
    let client = listener.client::<u8, u8>("ad").unwrap();
    assert!(!server.why().unwrap().is_empty() && !client.why().unwrap().is_empty());
}

//= SM2-SCH-001, SM2-SCH-002 test
#[test]
fn types_that_are_declared_can_be_described() {
    let mut domain = Domain::new();
    let (node, tool) = (domain.node("node"), domain.node("tool"));
    let numbers = <[f64]>::type_id();
    assert_eq!(tool.describe(&numbers).unwrap(), None);
    let publisher = node.publisher::<[f64]>("a").unwrap();
    let _service = node.server::<str, u16>("b").unwrap();
    for data in [numbers.clone(), str::type_id(), u16::type_id()] {
        let text = tool.describe(&data).unwrap().expect("a text");
        assert!(text.starts_with("plain:"), "{text}");
    }
    let text = "plain:u32";
    let data = TypeId {
        name: sm2_node::Name::new("mine").unwrap(),
        hash: sm2_node::schema::message("plain", sm2_node::schema::text("u32")),
    };
    tool.register_schema(data.clone(), text).unwrap();
    assert!(tool.register_schema(data.clone(), "plain:u64").is_err());
    assert!(tool.register_schema(data.clone(), "plain:").is_err());
    // The text is registered again at the next Manager.
    domain.stop();
    away(&[&node, &tool]);
    domain.start();
    back(&[&node, &tool]);
    until(|| node.describe(&numbers).unwrap().is_some());
    until(|| node.describe(&data).unwrap().as_deref() == Some(text));
    drop(publisher);
}

//= SM2-SCH-001, SM2-SCH-002, SM2-TYP-002 test
#[test]
fn a_definition_of_ros_2_can_be_registered_and_described() {
    let domain = Domain::new();
    let (node, tool) = (domain.node("node"), domain.node("tool"));
    let first = "cdr:RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
    let text = format!("{first}\nstring data\n");
    let data = TypeId {
        name: sm2_node::Name::new("std_msgs/msg/String").unwrap(),
        hash: sm2_node::schema::text(first),
    };
    let no_line_feed = node.register_schema(data.clone(), text.trim_end());
    assert!(no_line_feed.is_err());
    let another_hash = text.replace("df66", "df67");
    assert!(node.register_schema(data.clone(), &another_hash).is_err());
    node.register_schema(data.clone(), &text).unwrap();
    until(|| tool.describe(&data).unwrap().as_deref() == Some(&text));
}
