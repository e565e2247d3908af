//! Take-over: the links of an earlier Manager that are adopted, and the pairs that are linked anew
//! (SPEC section 11).

use std::time::Duration;

use crate::claims::{
    DEMANDING, KEY, LINK, OFFERING, back, back_as, both_back, claimed, entity, link_item,
    links_made, relations, wanted,
};
use crate::support::{
    bench::{Bench, Event, UNLIMITED, claim, seen_by, unlink},
    contracts::{client, data, publisher_with, scan, server, subscriber, subscriber_with},
};
use sm2_proto::{
    Code, Contract, InterfaceId, LinkId, LinkKey, Machine, NodeId,
    control::{Item, Limit, Limits, ToManager, ToNode, UnlinkedReason},
    manager::Input,
};

//= SM2-RES-004, SM2-RES-002, SM2-RES-007 test
#[test]
fn a_link_that_both_ends_claim_is_adopted() {
    for reversed in [false, true] {
        let (mut bench, a, b) = both_back(UNLIMITED);
        let mut ends = [(a, OFFERING), (b, DEMANDING)];
        if reversed {
            ends.reverse();
        }
        for (at, (node, interface)) in ends.into_iter().enumerate() {
            assert_eq!(bench.manager.links(), 0);
            let half = [Item::Claim {
                link: LINK,
                entity: entity(ends[0].0, ends[0].1),
            }];
            assert_eq!(relations(&bench, a), half[..at]);
            assert_eq!(bench.send(node, &claim(interface, LINK, KEY)), []);
        }
        let adopted = [link_item(LINK, entity(a, OFFERING), entity(b, DEMANDING))];
        assert_eq!(relations(&bench, a), adopted);
        // No link is made, and no node is told.
        for node in [b, a] {
            assert_eq!(claimed(&mut bench, node), []);
        }
        assert_eq!(bench.manager.links(), 1);
        assert_eq!(relations(&bench, a), adopted);
        assert_eq!(bench.manager.deadline(), None);
        // From here on it is an ordinary link.
        let events = bench.unlinked(a, OFFERING, LINK);
        assert_eq!(seen_by(&events, a), [unlink(OFFERING, LINK, 5)]);
        assert_eq!(seen_by(&events, b), [unlink(DEMANDING, LINK, 5)]);
        assert_eq!(bench.unlinked(b, DEMANDING, LINK), []);
        let unlinked = Item::Unlinked {
            offering: entity(a, OFFERING),
            demanding: entity(b, DEMANDING),
            reason: UnlinkedReason::Ended { code: Code(5) },
        };
        assert_eq!(relations(&bench, a), [unlinked]);
    }
}

//= SM2-RES-004 test
#[test]
fn both_ends_of_one_node() {
    let mut bench = Bench::new(UNLIMITED);
    let both = [(OFFERING, scan()), (DEMANDING, wanted())];
    let node = back(&mut bench, "a", &both);
    assert_eq!(bench.send(node, &claim(DEMANDING, LINK, KEY)), []);
    assert_eq!(bench.send(node, &claim(OFFERING, LINK, KEY)), []);
    assert_eq!(claimed(&mut bench, node), []);
    let adopted = link_item(LINK, entity(node, OFFERING), entity(node, DEMANDING));
    assert_eq!(relations(&bench, node), [adopted]);
    let events = bench.withdraw(node, OFFERING);
    assert_eq!(seen_by(&events, node)[0], unlink(DEMANDING, LINK, 0));
    bench.close(node);
    assert_eq!(bench.manager.links(), 0);
}

/// Until CLAIMED, the interfaces of a session are not linked, not even with each other.
//= SM2-RES-002, SM2-RES-007 test
#[test]
fn nothing_is_linked_before_claimed() {
    let mut bench = Bench::new(UNLIMITED);
    let both = [(1, scan()), (2, wanted())];
    let a = back(&mut bench, "a", &both);
    let b = bench.node(1, "b");
    assert_eq!(bench.declared(b, 1, &wanted()), []);
    assert_eq!(bench.declared(b, 2, &scan()).len(), 1, "b with itself");
    let c = back(&mut bench, "c", &both);
    let d = back(&mut bench, "d", &[(9, client("scan", None))]);
    assert_eq!(claimed(&mut bench, d), []);
    let ends = |one: (NodeId, u64), other: (NodeId, u64)| {
        [one, other].map(|(node, interface)| (node, InterfaceId(interface)))
    };
    let made = links_made(&claimed(&mut bench, a));
    let made: Vec<_> = made.into_iter().map(|(_, ends)| ends).collect();
    // In the order of a's interfaces, and not with c, which is still resuming.
    let expected = [
        ends((a, 1), (a, 2)),
        ends((a, 1), (b, 1)),
        ends((a, 2), (b, 2)),
    ];
    assert_eq!(made, expected);
    // A new interface of a is linked at once with all others, except with those of c.
    assert_eq!(bench.declared(a, 3, &wanted()).len(), 2);
    let made = links_made(&claimed(&mut bench, c));
    assert_eq!(made.len(), 1 + 3 + 2);
}

/// Claims that differ in any field are not paired. Claims that agree are adopted regardless.
//= SM2-RES-004, SM2-RES-006 test
#[test]
fn claims_that_differ() {
    let qos = |link, key, reliable, sealed| ToManager::Claim {
        interface: InterfaceId(OFFERING),
        link,
        key: LinkKey(key),
        version: 1,
        reliable,
        sealed,
    };
    let serial = LinkId { serial: 4, ..LINK };
    let epoch = LinkId { epoch: 0, ..LINK };
    for other in [
        qos(LINK, KEY + 1, false, false),
        qos(LINK, KEY, true, false),
        qos(LINK, KEY, false, true),
        qos(serial, KEY, false, false),
        qos(epoch, KEY, false, false),
    ] {
        let (mut bench, a, b) = both_back(UNLIMITED);
        let stranger = back(&mut bench, "c", &[(OFFERING, scan())]);
        assert_eq!(bench.send(stranger, &other), []);
        assert_eq!(bench.send(b, &claim(DEMANDING, LINK, KEY)), []);
        assert_eq!(bench.manager.links(), 0, "{other:?}");
        assert_eq!(bench.send(a, &claim(OFFERING, LINK, KEY)), []);
        assert_eq!(bench.manager.links(), 1, "{other:?}");
        let ToManager::Claim { link, .. } = other else {
            panic!("{other:?}");
        };
        for node in [a, b] {
            claimed(&mut bench, node);
        }
        let events = claimed(&mut bench, stranger);
        assert_eq!(links_made(&events).len(), 1, "with b, anew");
        bench.now = bench.now.after(Duration::from_secs(5));
        let told = Event::Sent(stranger, unlink(OFFERING, link, 5));
        assert_eq!(bench.input(Input::Tick), [told]);
        assert_eq!(bench.manager.links(), 2);
    }
}

/// Two nodes claim an invented link under the number of another link, before or after its owners
/// claim it. They also act in other hostile ways. The owners are not affected.
//= SM2-RES-004 test
#[test]
fn claims_without_the_key_change_nothing() {
    let mine = [(OFFERING, scan()), (DEMANDING, wanted())];
    let hostile = |bench: &mut Bench, text: &str| {
        let node = back(bench, text, &mine);
        for interface in [OFFERING, DEMANDING] {
            assert_eq!(bench.send(node, &claim(interface, LINK, 0)), []);
        }
        bench.unlinked(node, OFFERING, LINK);
        let node = back(bench, &format!("{text}-again"), &mine);
        for interface in [OFFERING, DEMANDING] {
            bench.send(node, &claim(interface, LINK, 1));
        }
        node
    };
    let (mut bench, a, b) = both_back(UNLIMITED);
    let before = hostile(&mut bench, "x");
    assert_eq!(bench.send(a, &claim(OFFERING, LINK, KEY)), []);
    hostile(&mut bench, "y");
    assert_eq!(bench.send(b, &claim(DEMANDING, LINK, KEY)), []);
    let last = hostile(&mut bench, "z");
    let mut seen = Vec::new();
    for node in [a, b] {
        assert_eq!(claimed(&mut bench, node), []);
    }
    for node in [before, last] {
        seen.extend(bench.withdraw(node, OFFERING));
        seen.extend(bench.close(node));
    }
    bench.now = bench.now.after(Duration::from_secs(10));
    seen.extend(bench.input(Input::Tick));
    assert_eq!(seen_by(&seen, a), []);
    assert_eq!(seen_by(&seen, b), []);
    let adopted = link_item(LINK, entity(a, OFFERING), entity(b, DEMANDING));
    assert_eq!(relations(&bench, a), [adopted]);
}

/// Each link is adopted if its QoS fits. Otherwise both ends are told `not-adopted` and, if they
/// match, linked anew.
fn adoption(limits: Limits, one: (u32, &Contract), other: (u32, &Contract), qos: [bool; 2]) {
    let [reliable, sealed] = qos;
    let mut bench = Bench::new(limits);
    let a = back_as(&mut bench, one.0, "a", &[(1, one.1.clone())]);
    let b = back_as(&mut bench, other.0, "b", &[(2, other.1.clone())]);
    let claim = |interface| ToManager::Claim {
        interface: InterfaceId(interface),
        link: LINK,
        key: LinkKey(KEY),
        version: 1,
        reliable,
        sealed,
    };
    assert_eq!(bench.send(a, &claim(1)), []);
    let events = bench.send(b, &claim(2));
    let told = |events: &[Event]| {
        assert_eq!(seen_by(events, a), [unlink(1, LINK, 6)]);
        assert_eq!(seen_by(events, b), [unlink(2, LINK, 6)]);
    };
    // The QoS that a Manager would link the two with now.
    let mut anew = Bench::new(limits);
    let (c, d) = (anew.node(one.0, "c"), anew.node(other.0, "d"));
    anew.declared(c, 1, one.1);
    let made = anew.declare(d, 2, other.1);
    let made = seen_by(&made, c).into_iter().find_map(|frame| match frame {
        ToNode::Link {
            reliable, sealed, ..
        } => Some((reliable, sealed)),
        _ => None,
    });
    let fits = made.is_some_and(|(r, s)| r == reliable && (sealed || !s));
    if fits {
        assert_eq!(events, []);
    } else {
        told(&events);
    }
    assert_eq!(bench.manager.links(), usize::from(fits));
    claimed(&mut bench, a);
    let events = claimed(&mut bench, b);
    let expected = usize::from(made.is_some() && !fits);
    assert_eq!(links_made(&events).len(), expected, "{events:?}");
    if !fits {
        assert_eq!(bench.unlinked(a, 1, LINK), []);
        assert_eq!(bench.unlinked(b, 2, LINK), []);
    }
}

//= SM2-RES-005, SM2-MAT-003 test
#[test]
fn terms_of_adoption() {
    let booleans = [false, true];
    let types = [data("Scan"), data("Image")];
    let mut contracts = vec![
        (scan(), scan()),
        (scan(), subscriber("map", None)),
        (scan(), client("scan", None)),
        (
            server("plan", &types[0], &types[1]),
            client("plan", Some((&types[0], &types[1]))),
        ),
    ];
    for offered in booleans {
        for seals in booleans {
            for demanded in booleans {
                contracts.push((
                    publisher_with("scan", &types[0], offered, seals),
                    subscriber_with("scan", None, demanded, false),
                ));
            }
        }
    }
    for (one, other) in &contracts {
        for seal_all in booleans {
            for uid in [1, 2] {
                for waive_user_boundary in booleans {
                    let limits = Limits {
                        seal_all,
                        waive_user_boundary,
                        ..UNLIMITED
                    };
                    for reliable in booleans {
                        for sealed in booleans {
                            let qos = [reliable, sealed];
                            adoption(limits, (1, one), (uid, other), qos);
                            adoption(limits, (1, other), (uid, one), qos);
                        }
                    }
                }
            }
        }
    }
}

//= SM2-RES-005 test
#[test]
fn a_pair_has_one_link() {
    let (mut bench, a, b) = both_back(UNLIMITED);
    let second = LinkId { serial: 9, ..LINK };
    for link in [LINK, second] {
        assert_eq!(bench.send(a, &claim(OFFERING, link, KEY)), []);
    }
    assert_eq!(bench.send(b, &claim(DEMANDING, LINK, KEY)), []);
    let events = bench.send(b, &claim(DEMANDING, second, KEY));
    let both = [
        Event::Sent(b, unlink(DEMANDING, second, 6)),
        Event::Sent(a, unlink(OFFERING, second, 6)),
    ];
    assert_eq!(events, both);
    let adopted = link_item(LINK, entity(a, OFFERING), entity(b, DEMANDING));
    assert_eq!(relations(&bench, a), [adopted]);
    claimed(&mut bench, a);
    assert_eq!(claimed(&mut bench, b), []);
}

/// A link that was adopted and has ended is not made again, whichever of its ends still resumes.
//= SM2-RES-007, SM2-LNK-009 test
#[test]
fn a_pair_that_ended_its_link_stays_unlinked() {
    for a_is_ready in [false, true] {
        let (mut bench, a, b) = // Also where no page shows it.
            both_back(UNLIMITED.with(Limit::UnlinkedPerSession, 0));
        bench.send(a, &claim(OFFERING, LINK, KEY));
        if a_is_ready {
            claimed(&mut bench, a);
        }
        bench.send(b, &claim(DEMANDING, LINK, KEY));
        bench.unlinked(a, OFFERING, LINK);
        bench.unlinked(b, DEMANDING, LINK);
        if !a_is_ready {
            claimed(&mut bench, a);
        }
        assert_eq!(claimed(&mut bench, b), []);
        assert_eq!(bench.manager.links(), 0);
        assert_eq!(relations(&bench, a), []);
    }
}

/// The same two interfaces may still claim another link of theirs.
//= SM2-RES-004, SM2-WCH-004 test
#[test]
fn a_pair_that_was_unlinked_can_be_adopted() {
    let (mut bench, a, b) = both_back(UNLIMITED);
    let second = LinkId { serial: 9, ..LINK };
    for link in [LINK, second] {
        bench.send(a, &claim(OFFERING, link, KEY));
    }
    bench.send(b, &claim(DEMANDING, LINK, KEY));
    bench.unlinked(b, DEMANDING, LINK);
    assert!(matches!(
        relations(&bench, a)[..],
        [Item::Claim { .. }, Item::Unlinked { .. }]
    ));
    bench.send(b, &claim(DEMANDING, second, KEY));
    let adopted = link_item(second, entity(a, OFFERING), entity(b, DEMANDING));
    assert_eq!(relations(&bench, a), [adopted]);
}
