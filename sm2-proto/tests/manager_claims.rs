//! Take-over: the claims that a resuming session may make, and how claims end (SPEC section
//! 11).

use crate::support;
use std::time::Duration;

use crate::claims::{
    DEMANDING, KEY, LINK, OFFERING, back, both_back, claimed, entity, items, links_made, relations,
    violation, wanted,
};
use crate::support::{
    bench::{Bench, EPOCH, Event, UNLIMITED, claim, resuming, unlink, unlinked},
    contracts::{data, publisher, scan, subscriber},
};
use sm2_proto::{
    Code, Farewell, InterfaceId, LinkId, LinkKey, Machine, Quota, Refusal,
    control::{Item, Limit, ToManager, ToNode, UnlinkedReason},
    manager::{Cause, Input},
    violation,
};

//= SM2-RES-003 test
#[test]
fn claims_that_break_spec() {
    let (bench, a, _) = both_back(UNLIMITED);
    let own = LinkId {
        epoch: EPOCH,
        ..LINK
    };
    let versions = [0, 2].map(|version| ToManager::Claim {
        interface: InterfaceId(OFFERING),
        link: LINK,
        key: LinkKey(KEY),
        version,
        reliable: false,
        sealed: false,
    });
    for (rule, frame) in [
        (
            violation!(UnknownInterface, "SM2-RES-003"),
            claim(0, LINK, KEY),
        ),
        (
            violation!(UnknownInterface, "SM2-RES-003"),
            claim(DEMANDING, LINK, KEY),
        ),
        (
            violation!(UnknownInterface, "SM2-RES-003"),
            claim(DEMANDING, own, KEY),
        ),
        (
            violation!(BadClaim, "SM2-RES-003"),
            claim(OFFERING, own, KEY),
        ),
        (violation!(BadClaim, "SM2-RES-003"), versions[0].clone()),
        (violation!(BadClaim, "SM2-RES-003"), versions[1].clone()),
    ] {
        let mut bench = bench.clone();
        assert_eq!(violation(&mut bench, a, &frame), rule, "{frame:?}");
    }
}

/// A resuming interface has a link at most once: claimed, adopted, or told that it is over.
//= SM2-RES-003 test
#[test]
fn the_same_link_twice() {
    let again = claim(OFFERING, LINK, KEY + 1);
    let (mut bench, a, b) = both_back(UNLIMITED);
    bench.send(a, &claim(OFFERING, LINK, KEY));
    let mut half = bench.clone();
    assert_eq!(
        violation(&mut half, a, &again),
        violation!(BadClaim, "SM2-RES-003")
    );
    bench.send(b, &claim(DEMANDING, LINK, KEY));
    let mut adopted = bench.clone();
    assert_eq!(
        violation(&mut adopted, a, &again),
        violation!(BadClaim, "SM2-RES-003")
    );
    bench.unlinked(b, DEMANDING, LINK);
    assert_eq!(
        violation(&mut bench, a, &again),
        violation!(BadClaim, "SM2-RES-003")
    );
}

//= SM2-RES-003, SM2-SES-001 test
#[test]
fn claims_of_a_session_that_is_not_resuming() {
    for frame in [claim(OFFERING, LINK, KEY), ToManager::Claimed] {
        let mut bench = Bench::new(UNLIMITED);
        let fresh = bench.node(1, "a");
        bench.declared(fresh, OFFERING, &scan());
        let rule = violation(&mut bench, fresh, &frame);
        assert_eq!(rule, violation!(UnexpectedClaim, "SM2-RES-003"));
        let (mut bench, a, _) = both_back(UNLIMITED);
        claimed(&mut bench, a);
        let rule = violation(&mut bench, a, &frame);
        assert_eq!(rule, violation!(UnexpectedClaim, "SM2-RES-003"));
        let greeting = bench.connect(1);
        let rule = violation(&mut bench, greeting, &frame);
        assert_eq!(rule, violation!(ExpectedHello, "SM2-SES-001"));
    }
}

//= SM2-RES-006 test
#[test]
fn the_policy_sets_the_time_for_which_a_claim_waits() {
    for recovery_ms in [1_000, 60_000] {
        let limits = UNLIMITED.with(Limit::Recovery, recovery_ms);
        let (recovery, (mut bench, a, b)) = (limits.time(Limit::Recovery), both_back(limits));
        claimed(&mut bench, b);
        bench.send(a, &claim(OFFERING, LINK, KEY));
        claimed(&mut bench, a);
        assert_eq!(bench.manager.deadline(), Some(bench.now.after(recovery)));
    }
}

//= SM2-RES-006 test
#[test]
fn a_claim_without_counterpart_expires() {
    let (mut bench, a, b) = both_back(UNLIMITED);
    let start = bench.now;
    bench.send(a, &claim(OFFERING, LINK, KEY));
    bench.now = start.after(Duration::from_secs(1));
    assert_eq!(claimed(&mut bench, a), []);
    bench.now = start.after(Duration::from_millis(1_500));
    // The time of a claim starts with CLAIMED of its own session.
    bench.send(b, &claim(DEMANDING, LINK, KEY + 1));
    let events = claimed(&mut bench, b);
    assert_eq!(links_made(&events).len(), 1, "a claim hinders nobody");
    let due = start.after(Duration::from_secs(6));
    assert_eq!(bench.manager.deadline(), Some(due));
    bench.now = sm2_proto::Instant(due.0 - 1);
    assert_eq!(bench.input(Input::Tick), []);
    bench.now = due;
    let told = Event::Sent(a, unlink(OFFERING, LINK, 5));
    assert_eq!(bench.input(Input::Tick), [told]);
    assert_eq!(bench.unlinked(a, OFFERING, LINK), []);
    let due = start.after(Duration::from_millis(6_500));
    assert_eq!(bench.manager.deadline(), Some(due));
    bench.now = due;
    let told = Event::Sent(b, unlink(DEMANDING, LINK, 5));
    assert_eq!(bench.input(Input::Tick), [told]);
    assert_eq!(bench.manager.deadline(), None);
    assert_eq!(bench.manager.links(), 1);
}

//= SM2-RES-006 test
#[test]
fn a_claim_ends_like_any_link() {
    let claims = |bench: &Bench, asks| relations(bench, asks).len();
    // After UNLINKED is answered, the link is over.
    let (mut bench, a, b) = both_back(UNLIMITED);
    bench.send(a, &claim(OFFERING, LINK, KEY));
    let mut withdrawn = bench.clone();
    let mut dead = bench.clone();
    let told = Event::Sent(a, unlink(OFFERING, LINK, 5));
    assert_eq!(bench.unlinked(a, OFFERING, LINK), [told]);
    let rule = violation(&mut bench.clone(), a, &unlinked(OFFERING, LINK));
    assert_eq!(rule, violation!(UnknownLink, "SM2-LNK-003"));
    assert_eq!(claims(&bench, b), 0);
    // The counterpart arrives too late, so its own claim stays without a partner.
    bench.send(b, &claim(DEMANDING, LINK, KEY));
    assert_eq!((bench.manager.links(), claims(&bench, b)), (0, 1));
    // The interface is withdrawn.
    let gone = ToNode::Withdrawn {
        interface: InterfaceId(OFFERING),
    };
    assert_eq!(withdrawn.withdraw(a, OFFERING), [Event::Sent(a, gone)]);
    assert_eq!(claims(&withdrawn, b), 0);
    // The claiming node dies, before and after the end of its resumption.
    let mut later = dead.clone();
    claimed(&mut later, a);
    for bench in [&mut dead, &mut later] {
        assert!(matches!(bench.close(a)[..], [Event::HungUp(..)]));
        assert_eq!(claims(bench, b), 0);
        claimed(bench, b);
        assert_eq!(bench.manager.deadline(), None);
    }
}

//= SM2-RES-008, SM2-RES-007, SM2-WCH-004 test
#[test]
fn quotas_of_links() {
    let limits = UNLIMITED.with(Limit::LinksPerSession, 2);
    let links = [1, 2, 3].map(|serial| LinkId { serial, ..LINK });
    let mut bench = Bench::new(limits);
    let a = back(&mut bench, "a", &[(1, scan())]);
    let others = ["b", "c", "d"].map(|text| back(&mut bench, text, &[(1, wanted())]));
    for (node, link) in others.into_iter().zip(links) {
        assert_eq!(bench.send(node, &claim(1, link, KEY)), []);
    }
    for link in &links[..2] {
        assert_eq!(bench.send(a, &claim(1, *link, KEY)), []);
    }
    let over = Event::Sent(a, unlink(1, links[2], 4));
    assert_eq!(bench.send(a, &claim(1, links[2], KEY)), [over]);
    assert_eq!(bench.manager.links(), 2);
    assert_eq!(bench.unlinked(a, 1, links[2]), []);
    claimed(&mut bench, a);
    for node in others {
        assert_eq!(claimed(&mut bench, node), [], "no room, and no refusal");
    }
    let unlinked = Item::Unlinked {
        offering: entity(a, 1),
        demanding: entity(others[2], 1),
        reason: UnlinkedReason::Quota { node: a, limit: 2 },
    };
    assert_eq!(relations(&bench, a).last(), Some(&unlinked));
    // A link within one session has two ends, too.
    let both = [
        (1, publisher("map", &data("Map"))),
        (2, subscriber("map", None)),
    ];
    let limits = UNLIMITED.with(Limit::LinksPerSession, 1);
    let mut bench = Bench::new(limits);
    let node = back(&mut bench, "a", &both);
    assert_eq!(claimed(&mut bench, node), []);
    let unlinked = Item::Unlinked {
        offering: entity(node, 1),
        demanding: entity(node, 2),
        reason: UnlinkedReason::Quota { node, limit: 1 },
    };
    assert_eq!(relations(&bench, node), [unlinked]);
}

//= SM2-RES-008 test
#[test]
fn other_quotas_hold_from_the_first_frame() {
    let mut bench = Bench::new(
        UNLIMITED
            .with(Limit::SessionsPerUser, 1)
            .with(Limit::InterfacesPerSession, 1),
    );
    let a = back(&mut bench, "a", &[(1, scan())]);
    let quota = |quota| Refusal::Quota { quota, limit: 1 };
    let interface = InterfaceId(2);
    let refused = ToNode::DeclareRefused {
        interface,
        reason: quota(Quota::InterfacesPerSession),
    };
    let events = bench.declare(a, 2, &wanted());
    assert_eq!(events, [Event::Sent(a, refused)]);
    let b = bench.connect(1);
    let refused = ToNode::HelloRefused {
        reason: quota(Quota::SessionsPerUser),
    };
    assert_eq!(bench.send(b, &resuming("b")), [Event::Sent(b, refused)]);
}

/// No node can have more open links than the limit, whether or not it was told that they ended.
//= SM2-RES-008 test
#[test]
fn claims_without_end() {
    let mut bench = Bench::new(UNLIMITED.with(Limit::LinksPerSession, 1));
    let a = back(&mut bench, "a", &[(1, scan())]);
    for serial in 1..=65_536 {
        let link = LinkId { serial, ..LINK };
        let events = bench.send(a, &claim(1, link, KEY));
        assert_eq!(events.len(), usize::from(serial > 1));
    }
    let link = LinkId { serial: 0, ..LINK };
    let cause = Cause::Farewell(Farewell::Resources);
    let events = bench.send(a, &claim(1, link, KEY));
    assert_eq!(events, [Event::HungUp(a, Some(Code(4)), cause)]);
}

//= SM2-SES-004 test
#[test]
fn the_time_to_greet_runs_until_claimed() {
    let mut bench = Bench::new(UNLIMITED);
    let start = bench.now;
    let a = bench.connect(1);
    let b = bench.connect(1);
    let due = start.after(Duration::from_secs(2));
    bench.now = start.after(Duration::from_secs(1));
    bench.send(a, &resuming("a"));
    bench.declared(a, 1, &scan());
    bench.send(b, &resuming("b"));
    assert_eq!(bench.manager.deadline(), Some(due));
    claimed(&mut bench, b);
    assert_eq!(bench.manager.deadline(), Some(due));
    bench.now = due;
    let cause = Cause::Farewell(Farewell::GreetingTimeout);
    let hung_up = Event::HungUp(a, Some(Code(1)), cause);
    assert_eq!(bench.input(Input::Tick), [hung_up]);
    assert_eq!(bench.manager.deadline(), None);
    assert!(bench.is_known(b));
    // The name and the interface of the session are gone with it.
    bench.hello(b, "a");
    let c = bench.node(1, "a");
    assert_eq!(bench.declared(c, 1, &wanted()), []);
}

/// A name that another node has taken in the meantime is refused.
//= SM2-RES-001, SM2-SES-003 test
#[test]
fn a_name_taken_across_the_gap() {
    let mut bench = Bench::new(UNLIMITED);
    let thief = bench.node(1, "a");
    let a = bench.connect(1);
    let refused = Event::Sent(
        a,
        ToNode::HelloRefused {
            reason: Refusal::NameTaken,
        },
    );
    assert_eq!(bench.send(a, &resuming("a")), [refused]);
    bench.close(thief);
    assert!(matches!(
        bench.send(a, &resuming("a"))[..],
        [Event::Sent(_, ToNode::Welcome { .. })]
    ));
}

/// An interface that was refused during the resumption can be neither claimed for nor linked.
//= SM2-RES-010, SM2-IFC-005 test
#[test]
fn an_interface_that_is_refused_now() {
    let mut bench = Bench::new(UNLIMITED);
    let other = bench.node(1, "b");
    bench.declared(other, 1, &publisher("scan", &data("Image")));
    let a = back(&mut bench, "a", &[]);
    let events = bench.declare(a, 1, &scan());
    assert!(matches!(
        events[..],
        [Event::Sent(_, ToNode::DeclareRefused { .. })]
    ));
    let mut claims = bench.clone();
    let rule = violation(&mut claims, a, &claim(1, LINK, KEY));
    assert_eq!(rule, violation!(UnknownInterface, "SM2-RES-003"));
    assert_eq!(claimed(&mut bench, a), []);
}

/// A node is shown as resuming until it has sent CLAIMED.
//= SM2-IFC-007 test
#[test]
fn resuming_shows() {
    let mut bench = Bench::new(UNLIMITED);
    let a = back(&mut bench, "a", &[]);
    let shown = |bench: &Bench| match &items(bench, a)[..] {
        [Item::Domain { .. }, Item::Node { resuming, .. }] => *resuming,
        other => panic!("{other:?}"),
    };
    assert!(shown(&bench));
    let revision = bench.manager.revision();
    claimed(&mut bench, a);
    assert!(!shown(&bench));
    assert!(bench.manager.revision() > revision);
}

/// Both ends of a link have the same key. Each link and each Manager has another one.
//= SM2-LNK-002 test
#[test]
fn keys_of_links() {
    let keys = |mut bench: Bench| {
        let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
        bench.declared(a, 1, &scan());
        let mut keys = Vec::new();
        for interface in 1..=50 {
            let events = bench.declare(b, interface, &wanted());
            let Some(Event::Linked(_, ends)) = events.last() else {
                panic!("{events:?}");
            };
            let both = [&ends[0], &ends[1]].map(|(_, frame)| match frame {
                ToNode::Link { key, .. } => *key,
                other => panic!("{other:?} is no LINK"),
            });
            assert_eq!(both[0], both[1]);
            keys.push(both[0]);
        }
        keys
    };
    let mut all = keys(Bench::new(UNLIMITED));
    // SipHash-2-4 of 1 under the bench's secret, by the reference implementation.
    assert_eq!(all[0], LinkKey(support::bench::FIRST_KEY));
    all.extend(keys(Bench::with_secret(UNLIMITED, 1)));
    all.sort_unstable();
    all.dedup();
    assert_eq!(all.len(), 100);
}
