//! WATCH: a node that reads pages and then changes has the current state of the domain.

use crate::support;
use std::collections::BTreeMap;

use crate::support::{
    bench::{Bench, EPOCH, Event, UNLIMITED, claim, resuming, seen_by, unlinked, withdraw},
    cases,
    contracts::{data, publisher, scan, server, subscriber},
};
use proptest::{collection::vec, prelude::*};
use sm2_proto::{
    Code, Contract, EntityId, InterfaceId, LinkId, NodeId,
    control::{Change, Changes, Item, Key, Limit, Limits, Page, ToManager, ToNode, encode_to_node},
    limits::DATAGRAM_MAX,
    manager::{Cause, Input},
    violation,
};

fn watch(after: u64) -> ToManager {
    ToManager::Watch { after }
}

fn changes(frames: Vec<ToNode>) -> Vec<Changes> {
    let read = |frame: ToNode| {
        assert!(encode_to_node(&frame).len() <= DATAGRAM_MAX);
        match frame {
            ToNode::Changes(changes) => changes,
            other => panic!("{other:?}"),
        }
    };
    frames.into_iter().map(read).collect()
}

/// The answer to a WATCH that does not wait.
fn asked(bench: &mut Bench, node: NodeId, after: u64) -> Changes {
    let events = bench.send(node, &watch(after));
    let mut answers = changes(seen_by(&events, node));
    assert_eq!(answers.len(), 1, "{events:?}");
    answers.remove(0)
}

fn member(node: NodeId, interface: u64) -> Key {
    let interface = InterfaceId(interface);
    Key::Member {
        entity: EntityId { node, interface },
    }
}

fn keys(changes: &Changes) -> Vec<(Key, bool)> {
    let changes = changes.changes.iter().flatten();
    let key = |change: &Change| match change {
        Change::Set { item } => (item.key(), true),
        Change::Removed { key } => (*key, false),
    };
    changes.map(key).collect()
}

//= SM2-WCH-001 test
#[test]
fn each_watch_is_answered_once() {
    let mut bench = Bench::new(UNLIMITED);
    let (a, b, c) = (bench.node(1, "a"), bench.node(1, "b"), bench.node(1, "c"));
    let now = bench.manager.revision();
    for node in [a, b] {
        assert_eq!(bench.send(node, &watch(now)), []);
    }
    // An input that changes nothing wakes no watcher.
    assert_eq!(bench.input(Input::Tick), []);
    let stranger = bench.connect(1);
    bench.close(stranger);
    bench.send(c, &ToManager::Query { after: None });
    let events = bench.declare(c, 1, &scan());
    for node in [a, b] {
        let answers = changes(seen_by(&events, node));
        assert_eq!(answers.len(), 1);
        assert_eq!(answers[0].revision, bench.manager.revision());
        assert_eq!(keys(&answers[0]), [(member(c, 1), true)]);
    }
    // Each WATCH is answered once.
    let events = bench.withdraw(c, 1);
    assert_eq!(seen_by(&events, a), []);
    // A node's own change counts too, and a WATCH of a past revision is answered at once.
    let answer = asked(&mut bench, a, now);
    assert_eq!(keys(&answer), [(member(c, 1), false)]);
    bench.send(a, &watch(answer.revision));
    let events = bench.declare(a, 1, &scan());
    assert_eq!(seen_by(&events, a).len(), 2);
    // A watcher that dies is not answered and leaves no state.
    bench.send(a, &watch(bench.manager.revision()));
    let events = bench.close(a);
    assert_eq!(events.len(), 1, "{events:?}");
}

//= SM2-WCH-001 test
#[test]
fn a_second_watch() {
    let mut bench = Bench::new(UNLIMITED);
    let node = bench.node(1, "a");
    let now = bench.manager.revision();
    bench.send(node, &watch(now));
    for after in [now, 0, now + 1] {
        let mut bench = bench.clone();
        let events = bench.send(node, &watch(after));
        let cause = Cause::Violation(violation!(WatchTwice, "SM2-WCH-001"));
        let hung_up = Event::HungUp(node, Some(Code(40)), cause);
        assert_eq!(events, [hung_up]);
    }
    // A WATCH after the answer is not a second one.
    bench.declare(node, 1, &scan());
    let now = bench.manager.revision();
    assert_eq!(bench.send(node, &watch(now)), []);
}

/// Each key once, in the order of its first change, with its present item.
//= SM2-WCH-002 test
#[test]
fn changes_of_one_key_are_one_change() {
    let mut bench = Bench::new(UNLIMITED);
    let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
    let start = bench.manager.revision();
    bench.declared(a, 1, &scan());
    let link = bench.declared(b, 1, &subscriber("scan", None))[0];
    bench.declared(a, 2, &publisher("map", &data("Map")));
    bench.unlinked(a, 1, link);
    bench.withdraw(a, 2);
    bench.declare(b, 2, &publisher("scan", &data("Image")));
    bench.declared(b, 3, &publisher("scan", &data("Scan")));
    let entity = |node, interface| EntityId {
        node,
        interface: InterfaceId(interface),
    };
    let answer = asked(&mut bench, a, start);
    let expected = [
        (member(a, 1), true),
        (member(b, 1), true),
        (
            Key::Link {
                link,
                offering: entity(a, 1),
            },
            false,
        ),
        (member(a, 2), false),
        (
            Key::Unlinked {
                offering: entity(a, 1),
                demanding: entity(b, 1),
            },
            true,
        ),
        (member(b, 2), false),
        (member(b, 3), true),
    ];
    assert_eq!(keys(&answer)[..7], expected);
    assert_eq!(
        (answer.more, answer.revision),
        (false, bench.manager.revision())
    );
}

/// The oldest refusal makes room for the next one, and a watcher hears of both.
//= SM2-WCH-004 test
#[test]
fn a_refusal_that_is_forgotten_is_removed() {
    let mut bench = Bench::new(UNLIMITED.with(Limit::RefusalsPerSession, 1));
    let (a, b) = (bench.node(1, "a"), bench.node(1, "b"));
    bench.declared(a, 1, &scan());
    let wrong = publisher("scan", &data("Image"));
    bench.declare(b, 1, &wrong);
    let before = bench.manager.revision();
    bench.declare(b, 2, &wrong);
    let answer = asked(&mut bench, a, before);
    let mut told = keys(&answer);
    told.sort();
    assert_eq!(told, [(member(b, 1), false), (member(b, 2), true)]);
}

//= SM2-WCH-002 test
#[test]
fn what_is_forgotten_or_never_was() {
    let mut bench = Bench::new(UNLIMITED.with(Limit::ChangesRemembered, 3));
    let node = bench.node(1, "a");
    for interface in 1..=5 {
        bench.declared(node, interface, &publisher("map", &data("Map")));
    }
    let now = bench.manager.revision();
    for after in 0..now + 3 {
        if after == now {
            continue;
        }
        let answer = asked(&mut bench, node, after);
        assert_eq!((answer.revision, answer.more), (now, false));
        let known = (now - 3..now).contains(&after);
        assert_eq!(answer.changes.is_some(), known, "after {after}");
        if known {
            assert_eq!(keys(&answer).len() as u64, now - after);
        }
    }
    asked(&mut bench, node, u64::MAX);
}

/// Changes that do not fit into a datagram come in parts, each as full as possible.
//= SM2-WCH-002, SM2-WCH-003, SM2-TRN-004 test
#[test]
fn changes_that_do_not_fit() {
    let mut bench = Bench::new(UNLIMITED);
    let node = bench.node(1, "a");
    let start = bench.manager.revision();
    let long = "x".repeat(200);
    let mut expected = Vec::new();
    for interface in 1..=300 {
        let contract = server(&format!("{long}/{interface}"), &data(&long), &data(&long));
        bench.declared(node, interface, &contract);
        expected.push((member(node, interface), true));
    }
    // The first part ends before the latest change of this item.
    bench.withdraw(node, 3);
    expected[2].1 = false;
    let mut after = start;
    let mut all = Vec::new();
    let mut parts = 0;
    loop {
        let answer = asked(&mut bench, node, after);
        parts += 1;
        assert!(answer.revision > after);
        after = answer.revision;
        let before = all.len();
        all.extend(keys(&answer));
        if !answer.more {
            break;
        }
        // One more change would not have fitted.
        let (changes, revision) = (answer.changes, answer.revision);
        let bytes = encode_to_node(&ToNode::Changes(Changes {
            revision,
            changes,
            more: true,
        }));
        assert!(bytes.len() > DATAGRAM_MAX - 700, "{} bytes", bytes.len());
        assert_eq!(revision - start, all.len() as u64, "{before}");
    }
    assert!(parts > 2);
    // An item that changed again after its part comes again.
    let again = (member(node, 3), false);
    assert_eq!(all.pop(), Some(again));
    assert_eq!(all, expected);
    assert_eq!(after, bench.manager.revision());
}

/// The domain as seen by a node that reads pages first and then only changes.
#[derive(Clone, Debug, Default)]
struct Reader {
    items: BTreeMap<Key, Item>,
    revision: u64,
    /// The key after which the next page starts, if more follow.
    reading: Option<Option<Key>>,
}

impl Reader {
    fn fresh() -> Self {
        Self {
            reading: Some(None),
            ..Self::default()
        }
    }

    /// Reads one page, or the changes. Returns whether the state is exact.
    fn step(&mut self, bench: &mut Bench, node: NodeId) -> bool {
        if let Some(after) = self.reading {
            let events = bench.send(node, &ToManager::Query { after });
            let [
                Event::Sent(
                    _,
                    ToNode::Page(Page {
                        revision,
                        items,
                        next,
                    }),
                ),
            ] = &events[..]
            else {
                panic!("{events:?}");
            };
            if after.is_none() {
                self.revision = *revision;
            }
            let items = items.iter().cloned();
            self.items.extend(items.map(|item| (item.key(), item)));
            self.reading = next.map(Some);
            return false;
        }
        if self.revision == bench.manager.revision() {
            return true;
        }
        let answer = asked(bench, node, self.revision);
        let Some(changes) = answer.changes else {
            *self = Self::fresh();
            return false;
        };
        for change in changes {
            match change {
                Change::Set { item } => drop(self.items.insert(item.key(), item)),
                Change::Removed { key } => drop(self.items.remove(&key)),
            }
        }
        self.revision = answer.revision;
        !answer.more
    }
}

/// The exact state: all pages at one revision.
fn exact(bench: &mut Bench, node: NodeId) -> BTreeMap<Key, Item> {
    let mut reader = Reader::fresh();
    while reader.reading.is_some() {
        reader.step(bench, node);
    }
    reader.items
}

#[derive(Clone, Debug)]
enum Op {
    Declare(usize, u8),
    Withdraw(usize, u64),
    Unlinked(usize, u64, u64),
    Fail,
    Leave(usize),
    Join(usize, bool),
    Claim(usize, u64, u64),
    Claimed(usize),
    Read,
}

fn op() -> impl Strategy<Value = Op> {
    let slot = || 0..4_usize;
    prop_oneof![
        12 => (slot(), any::<u8>()).prop_map(|(at, it)| Op::Declare(at, it)),
        3 => (slot(), 1..20_u64).prop_map(|(at, it)| Op::Withdraw(at, it)),
        4 => (slot(), 1..12_u64, 1..30_u64).prop_map(|(at, it, link)| Op::Unlinked(at, it, link)),
        1 => Just(Op::Fail),
        2 => slot().prop_map(Op::Leave),
        4 => (slot(), any::<bool>()).prop_map(|(at, back)| Op::Join(at, back)),
        6 => (slot(), 1..6_u64, 1..4_u64).prop_map(|(at, it, link)| Op::Claim(at, it, link)),
        2 => slot().prop_map(Op::Claimed),
        12 => Just(Op::Read),
    ]
}

/// Long names, so that few items fill a page.
fn contract(choice: u8) -> Contract {
    let long = "y".repeat(230);
    let types = [data(&format!("{long}/A")), data(&format!("{long}/B"))];
    let name = format!("{long}/{}", choice & 1);
    let stated = &types[usize::from(choice & 32 != 0)];
    match choice & 6 {
        0 | 2 => publisher(&name, stated),
        4 => subscriber(&name, Some(stated)),
        _ => subscriber(&name, None),
    }
}

proptest! {
    #![proptest_config(cases(150))]

    /// This holds at any time, with any pages read before or after any change, also when the log
    /// does not reach back far enough.
    //= SM2-WCH-003, SM2-IFC-007 test
    #[test]
    fn pages_and_changes_are_exact(
        changes_remembered in prop_oneof![Just(8), Just(40), Just(4_096)],
        ops in vec(op(), 1..250),
    ) {
        let mut bench = Bench::new(Limits::default().with(Limit::ChangesRemembered, changes_remembered));
        let observer = bench.node(1, "observer");
        let mut nodes: [Option<(NodeId, u64)>; 4] = [None; 4];
        let mut reader = Reader::fresh();
        let mut was_exact = (0, BTreeMap::new());
        for op in ops {
            // Frames that a node must not send are left out, because its session would end.
            let send = |bench: &mut Bench, node: NodeId, frame: &ToManager| {
                let mut after = bench.clone();
                let events = after.send(node, frame);
                let ended = events.iter().any(|it| matches!(it, Event::HungUp(..)));
                if !ended {
                    *bench = after;
                }
            };
            match op {
                Op::Join(at, back) => if nodes[at].is_none() {
                    let text = format!("n{at}");
                    let node = bench.connect(1);
                    let hello = if back { resuming(&text) } else { support::bench::hello(&text) };
                    bench.send(node, &hello);
                    nodes[at] = Some((node, 0));
                },
                Op::Leave(at) => if let Some((node, _)) = nodes[at].take() {
                    bench.close(node);
                },
                Op::Declare(at, choice) => if let Some((node, last)) = &mut nodes[at] {
                    *last += 1;
                    bench.declare(*node, *last, &contract(choice));
                },
                Op::Withdraw(at, interface) => if let Some((node, _)) = nodes[at] {
                    send(&mut bench, node, &withdraw(interface));
                },
                Op::Unlinked(at, interface, serial) => if let Some((node, _)) = nodes[at] {
                    let link = LinkId { epoch: EPOCH, serial };
                    send(&mut bench, node, &unlinked(interface, link));
                },
                Op::Fail => {
                    let serial = bench.manager.links() as u64;
                    let link = LinkId { epoch: EPOCH, serial };
                    bench.input(Input::LinkFailed { link });
                }
                Op::Claim(at, interface, serial) => if let Some((node, _)) = nodes[at] {
                    let link = LinkId { epoch: EPOCH + 1, serial };
                    send(&mut bench, node, &claim(interface, link, 1));
                },
                Op::Claimed(at) => if let Some((node, _)) = nodes[at] {
                    send(&mut bench, node, &ToManager::Claimed);
                },
                Op::Read => if reader.step(&mut bench, observer) {
                    prop_assert_eq!(&reader.items, &exact(&mut bench, observer));
                },
            }
            // A revision identifies one state.
            let now = (bench.manager.revision(), exact(&mut bench, observer));
            if now.0 == was_exact.0 {
                prop_assert_eq!(&now.1, &was_exact.1);
            }
            was_exact = now;
        }
        while !reader.step(&mut bench, observer) {}
        prop_assert_eq!(&reader.items, &exact(&mut bench, observer));
    }
}
