//! The refusals and the unlinked pairs that the Manager remembers (SM2-WCH-004).

use crate::support;
use crate::support::{
    bench::{Bench, Event, UNLIMITED},
    contracts::{client, data, publisher, scan, server, subscriber, subscriber_with},
};
use sm2_proto::{
    Code, Contract, EntityId, InterfaceId, Machine, NodeId, Quota, Refusal,
    control::{Changes, Item, Key, Limit, Limits, Page, ToManager, ToNode, UnlinkedReason},
    manager::Input,
};

fn items(bench: &Bench, asks: NodeId) -> Vec<Item> {
    let mut aside = bench.clone();
    let mut all = Vec::new();
    let mut after = None;
    loop {
        let events = aside.send(asks, &ToManager::Query { after });
        let [Event::Sent(_, ToNode::Page(Page { items, next, .. }))] = &events[..] else {
            panic!("{events:?}");
        };
        all.extend(items.iter().cloned());
        after = *next;
        if after.is_none() {
            return all;
        }
    }
}

/// The numbers of refused interfaces, and the reasons.
fn refused(bench: &Bench, node: NodeId) -> Vec<(u64, Contract, Refusal)> {
    let refused = items(bench, node)
        .into_iter()
        .filter_map(|item| match item {
            Item::Refusal {
                entity,
                contract,
                reason,
            } if entity.node == node => Some((entity.interface.0, contract, reason)),
            _ => None,
        });
    refused.collect()
}

fn unlinked(bench: &Bench, asks: NodeId) -> Vec<(EntityId, EntityId, UnlinkedReason)> {
    let unlinked = items(bench, asks)
        .into_iter()
        .filter_map(|item| match item {
            Item::Unlinked {
                offering,
                demanding,
                reason,
            } => Some((offering, demanding, reason)),
            _ => None,
        });
    unlinked.collect()
}

fn entity(node: NodeId, interface: u64) -> EntityId {
    let interface = InterfaceId(interface);
    EntityId { node, interface }
}

fn wrong(topic: &str) -> Contract {
    publisher(topic, &data("Image"))
}

fn wanted() -> Contract {
    subscriber("scan", None)
}

//= SM2-WCH-004 test
#[test]
fn the_last_refusals_are_shown() {
    let mut bench = Bench::new(Limits::default());
    let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
    bench.declared(a, 1, &scan());
    let theirs = data("Scan");
    for interface in 1..=20 {
        bench.declare(b, interface, &wrong("scan"));
        let expected = (1..=interface).map(|it| {
            let reason = Refusal::TopicType {
                theirs: theirs.clone(),
            };
            (it, wrong("scan"), reason)
        });
        let expected: Vec<_> = expected
            .skip(interface.saturating_sub(16) as usize)
            .collect();
        assert_eq!(refused(&bench, b), expected);
    }
    assert_eq!(refused(&bench, a), []);
    // Each session has its own refusals.
    bench.declare(a, 2, &wrong("scan"));
    assert_eq!(refused(&bench, a).len(), 1);
    assert_eq!(refused(&bench, b).len(), 16);
    bench.close(a);
    assert_eq!(refused(&bench, b).len(), 16, "until the session ends");
    bench.close(b);
    let c = bench.node(1, "c");
    assert_eq!(items(&bench, c).len(), 2);
}

/// A later interface of the same session, kind and name is granted. Only that removes a refusal.
//= SM2-WCH-004 test
#[test]
fn what_is_granted_supersedes_what_was_refused() {
    let mut bench = Bench::new(UNLIMITED);
    let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
    let image = data("Image");
    bench.declared(a, 1, &scan());
    bench.declare(b, 1, &wrong("scan"));
    bench.declare(b, 2, &subscriber("scan", Some(&image)));
    bench.declare(b, 3, &wrong("scan"));
    let numbers = |bench: &Bench| {
        let refused = refused(bench, b).into_iter();
        refused.map(|(it, ..)| it).collect::<Vec<_>>()
    };
    bench.declared(a, 2, &scan());
    bench.declared(b, 4, &publisher("map", &image));
    bench.declared(b, 5, &server("scan", &image, &image));
    bench.declared(b, 6, &client("scan", None));
    assert_eq!(numbers(&bench), [1, 2, 3]);
    bench.declared(b, 7, &wanted());
    assert_eq!(numbers(&bench), [1, 3]);
    let after = bench.manager.revision();
    bench.declared(b, 8, &scan());
    assert_eq!(numbers(&bench), [0; 0]);
    // A watcher is told of both.
    let events = bench.send(a, &ToManager::Watch { after });
    let [
        Event::Sent(
            _,
            ToNode::Changes(Changes {
                changes: Some(changes),
                ..
            }),
        ),
    ] = &events[..]
    else {
        panic!("{events:?}");
    };
    for interface in [1, 3] {
        let key = Key::Member {
            entity: entity(b, interface),
        };
        assert!(changes.contains(&sm2_proto::control::Change::Removed { key }));
    }
}

//= SM2-WCH-004, SM2-IFC-006 test
#[test]
fn a_refusal_shows_its_quota() {
    let mut bench = Bench::new(UNLIMITED.with(Limit::InterfacesPerSession, 0));
    let node = bench.node(1, "a");
    bench.declare(node, 7, &scan());
    let reason = Refusal::Quota {
        quota: Quota::InterfacesPerSession,
        limit: 0,
    };
    assert_eq!(refused(&bench, node), [(7, scan(), reason)]);
}

/// The reason why a pair is not linked is shown from the first moment to the end of one of its
/// interfaces.
//= SM2-WCH-004, SM2-LNK-009, SM2-IFC-002, SM2-MAT-002 test
#[test]
fn causes() {
    let limit = 1;
    let mut bench = Bench::new(UNLIMITED.with(Limit::LinksPerSession, limit));
    let (a, b, c) = (bench.node(1, "a"), bench.node(1, "b"), bench.node(1, "c"));
    bench.declared(a, 1, &scan());
    // The types match, but this subscriber demands reliability that no publisher offers.
    let unreliable = support::contracts::publisher_with("lost", &data("T"), false, false);
    bench.declared(c, 1, &unreliable);
    bench.declared(c, 2, &subscriber_with("lost", None, true, false));
    assert_eq!(unlinked(&bench, a), []);
    let link = bench.declared(b, 1, &wanted())[0];
    bench.input(Input::LinkFailed { link });
    let failed = (entity(a, 1), entity(b, 1), UnlinkedReason::Descriptors);
    assert_eq!(unlinked(&bench, a), [failed]);
    let link = bench.declared(b, 2, &wanted())[0];
    let full = bench.declared(c, 3, &wanted());
    assert_eq!(full, [], "the other side has no room");
    let quota = UnlinkedReason::Quota { node: a, limit };
    let quota = (entity(a, 1), entity(c, 3), quota);
    assert_eq!(unlinked(&bench, a), [failed, quota]);
    // The other side's farewell does not change the reason.
    bench.unlinked(b, 2, link);
    bench.send(
        a,
        &ToManager::Unlinked {
            interface: InterfaceId(1),
            link,
            code: Code(9),
        },
    );
    let ended = (
        entity(a, 1),
        entity(b, 2),
        UnlinkedReason::Ended { code: Code(5) },
    );
    assert_eq!(unlinked(&bench, a), [failed, ended, quota]);
    bench.withdraw(b, 2);
    assert_eq!(unlinked(&bench, a), [failed, quota]);
    bench.close(c);
    assert_eq!(unlinked(&bench, a), [failed]);
    bench.withdraw(a, 1);
    assert_eq!(unlinked(&bench, b), []);
}

//= SM2-WCH-004 test
#[test]
fn so_many_unlinked_pairs_for_each_session() {
    let mut bench = Bench::new(Limits::default().with(Limit::LinksPerSession, 1));
    let (a, b, c) = (bench.node(1, "a"), bench.node(1, "b"), bench.node(1, "c"));
    // After that, c has no room for more unlinked pairs.
    bench.declared(a, 1, &scan());
    bench.declared(c, 1, &wanted());
    for interface in 2..=300 {
        let events = bench.declare(c, interface, &subscriber("map", None));
        assert_eq!(events.len(), 1);
    }
    bench.declared(b, 1, &publisher("map", &data("Map")));
    bench.declared(b, 2, &scan());
    let shown = |bench: &Bench| {
        let mut bench = bench.clone();
        // Pairs of an interface that is gone are forgotten in parts.
        while bench.manager.deadline() == Some(bench.now) {
            assert_eq!(bench.input(Input::Tick), []);
        }
        unlinked(&bench, a).len()
    };
    assert_eq!(shown(&bench), 256, "of 299 + 1");
    // The quota belongs to the session of the offering side; a has its own.
    bench.declared(a, 2, &publisher("map", &data("Map")));
    assert_eq!(shown(&bench), 512);
    // Each pair that is forgotten makes room for the next one.
    bench.withdraw(c, 2);
    assert_eq!(shown(&bench), 510);
    bench.withdraw(b, 1);
    bench.withdraw(a, 2);
    bench.declared(b, 3, &publisher("map", &data("Map")));
    assert_eq!(shown(&bench), 256);
    bench.close(b);
    assert_eq!(shown(&bench), 0);
}
