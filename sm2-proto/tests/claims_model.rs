//! Random claims of a few sessions, honest and not, against an oracle of SPEC section 11
//! that is a few lists: who is linked with whom, whose claim waits, who is told what.

#[path = "support/claims_oracle.rs"]
mod claims_oracle;
mod support;

use std::{collections::BTreeSet, time::Duration};

use claims_oracle::{Oracle, Said, Session, Told};
use proptest::{collection::vec, prelude::*};
use sm2_proto::{
    Contract, InterfaceId, LinkId, NodeId, Place,
    control::{Item, Key, ToManager, ToNode},
    manager::{Input, Policy},
};
use support::{
    bench::{Bench, EPOCH, Event, UNLIMITED, hello, resuming, unlinked, withdraw},
    cases,
    contracts::{data, publisher_with, subscriber_with},
};

const SLOTS: usize = 4;
const INTERFACES: u64 = 3;

#[derive(Clone, Debug)]
enum Op {
    Join(usize, bool, u32),
    Leave(usize),
    Declare(usize, Contract),
    Withdraw(usize, u64),
    Claim(usize, u64, Said),
    Claimed(usize),
    /// Ends a link that the node has, or is told to end.
    Unlinked(usize, usize),
    Wait(u64),
}

fn contract() -> impl Strategy<Value = Contract> {
    any::<[bool; 4]>().prop_map(|[offers, other, reliable, sealed]| {
        let topic = if other { "map" } else { "scan" };
        if offers {
            publisher_with(topic, &data("T"), reliable, sealed)
        } else {
            subscriber_with(topic, None, reliable, sealed)
        }
    })
}

fn said() -> impl Strategy<Value = Said> {
    let rarely = || prop_oneof![4 => Just(false), 1 => Just(true)];
    (1..4_u64, rarely(), rarely(), any::<bool>()).prop_map(|(serial, key, reliable, sealed)| Said {
        serial,
        key: u64::from(key),
        reliable,
        sealed,
    })
}

fn op() -> impl Strategy<Value = Op> {
    let slot = || 0..SLOTS;
    let uid = || prop_oneof![6 => Just(1_u32), 1 => Just(2)];
    prop_oneof![
        5 => (slot(), prop_oneof![4 => Just(true), 1 => Just(false)], uid())
            .prop_map(|(at, back, uid)| Op::Join(at, back, uid)),
        1 => slot().prop_map(Op::Leave),
        10 => (slot(), contract()).prop_map(|(at, it)| Op::Declare(at, it)),
        1 => (slot(), 1..=INTERFACES).prop_map(|(at, it)| Op::Withdraw(at, it)),
        16 => (slot(), 1..=INTERFACES, said()).prop_map(|(at, it, said)| Op::Claim(at, it, said)),
        3 => slot().prop_map(Op::Claimed),
        4 => (slot(), 0..6_usize).prop_map(|(at, pick)| Op::Unlinked(at, pick)),
        1 => (0..3_000_u64).prop_map(Op::Wait),
    ]
}

/// What the Manager told everybody of links.
fn told(events: &[Event]) -> Vec<Told> {
    let one = |node: NodeId, frame: &ToNode| match *frame {
        ToNode::Unlink {
            interface,
            link,
            code,
        } => Some((Place { node, interface }, link, Some(code.0))),
        ToNode::Link {
            interface, link, ..
        } => Some((Place { node, interface }, link, None)),
        _ => None,
    };
    let each = events.iter().flat_map(|event| match event {
        Event::Sent(to, frame) => vec![one(*to, frame)],
        Event::Linked(_, ends) => ends.iter().map(|(to, frame)| one(*to, frame)).collect(),
        _ => Vec::new(),
    });
    let mut told: Vec<Told> = each.flatten().collect();
    told.sort_unstable();
    told
}

fn relations(bench: &Bench, asks: NodeId) -> Vec<Item> {
    let mut aside = bench.clone();
    let before = Key::Member {
        place: Place {
            node: NodeId(u64::MAX),
            interface: InterfaceId(u64::MAX),
        },
    };
    let after = Some(before);
    let events = aside.send(asks, &ToManager::Query { after });
    let [
        Event::Sent(
            _,
            ToNode::Page {
                items, next: None, ..
            },
        ),
    ] = &events[..]
    else {
        panic!("{events:?}");
    };
    let related = |item: &&Item| !matches!(item, Item::Apart { .. });
    items.iter().filter(related).cloned().collect()
}

/// Does one thing to both; what the Manager said of links.
fn step(
    bench: &mut Bench,
    oracle: &mut Oracle,
    slots: &mut [Option<NodeId>; SLOTS],
    policy: &Policy,
    op: Op,
) -> Vec<Event> {
    let session = |oracle: &Oracle, at: usize| {
        let node = slots[at].filter(|node| oracle.sessions.contains_key(node));
        node.map(|node| oracle.sessions[&node].clone())
    };
    let at_place = |node: NodeId, interface: u64| Place {
        node,
        interface: InterfaceId(interface),
    };
    match op {
        Op::Join(at, back, uid) if session(oracle, at).is_none() => {
            let text = format!("n{at}");
            let node = bench.connect(uid);
            bench.send(node, &if back { resuming(&text) } else { hello(&text) });
            slots[at] = Some(node);
            oracle.sessions.insert(
                node,
                Session {
                    node,
                    uid,
                    resuming: back,
                    last: 0,
                    greet_until: oracle.now + 2_000,
                },
            );
            Vec::new()
        }
        Op::Leave(at) => match session(oracle, at) {
            Some(Session { node, .. }) => {
                oracle.leave(node);
                bench.close(node)
            }
            None => Vec::new(),
        },
        Op::Declare(at, contract) => match session(oracle, at) {
            Some(Session {
                node,
                resuming,
                last,
                ..
            }) if last < INTERFACES => {
                let place = at_place(node, last + 1);
                oracle.interfaces.insert(place, contract.clone());
                if let Some(session) = oracle.sessions.get_mut(&node) {
                    session.last += 1;
                }
                let events = bench.declare(node, last + 1, &contract);
                let matches = if resuming {
                    0
                } else {
                    oracle.link_all(policy, place)
                };
                let answer = ToNode::Declared {
                    interface: place.interface,
                    matches: u32::try_from(matches).expect("few"),
                };
                assert_eq!(events[0], Event::Sent(node, answer));
                events
            }
            _ => Vec::new(),
        },
        Op::Withdraw(at, interface) => match session(oracle, at) {
            Some(Session { node, .. })
                if oracle.interfaces.contains_key(&at_place(node, interface)) =>
            {
                let place = at_place(node, interface);
                oracle.interfaces.remove(&place);
                oracle.drop_end(place, None, 0);
                bench.send(node, &withdraw(interface))
            }
            _ => Vec::new(),
        },
        Op::Claim(at, interface, said) => {
            let id = LinkId {
                epoch: EPOCH - 1,
                serial: said.serial,
            };
            match session(oracle, at) {
                Some(Session {
                    node,
                    resuming: true,
                    ..
                }) if oracle.interfaces.contains_key(&at_place(node, interface))
                    && !oracle.has(at_place(node, interface), id) =>
                {
                    oracle.claim(policy, at_place(node, interface), id, said);
                    let frame = ToManager::Claim {
                        interface: InterfaceId(interface),
                        link: id,
                        key: said.key,
                        version: 1,
                        reliable: said.reliable,
                        sealed: said.sealed,
                    };
                    bench.send(node, &frame)
                }
                _ => Vec::new(),
            }
        }
        Op::Claimed(at) => match session(oracle, at) {
            Some(Session {
                node,
                resuming: true,
                ..
            }) => {
                if let Some(session) = oracle.sessions.get_mut(&node) {
                    session.resuming = false;
                }
                for half in &mut oracle.halves {
                    if half.place.node == node {
                        half.until = Some(oracle.now + 5_000);
                    }
                }
                let places: Vec<Place> = oracle.interfaces.keys().copied().collect();
                for place in places.into_iter().filter(|it| it.node == node) {
                    oracle.link_all(policy, place);
                }
                bench.send(node, &ToManager::Claimed)
            }
            _ => Vec::new(),
        },
        Op::Unlinked(at, pick) => {
            let Some(Session { node, .. }) = session(oracle, at) else {
                return Vec::new();
            };
            let mut own: BTreeSet<(Place, LinkId)> = oracle.told.clone();
            own.extend(oracle.halves.iter().map(|it| (it.place, it.id)));
            own.extend(
                oracle
                    .links
                    .iter()
                    .flat_map(|it| it.ends.map(|end| (end, it.id))),
            );
            own.retain(|(place, _)| place.node == node);
            let Some(&(place, id)) = own.iter().nth(pick) else {
                return Vec::new();
            };
            if !oracle.told.contains(&(place, id)) {
                oracle.events.push((place, id, Some(5)));
            }
            oracle.drop_end(place, Some(id), 5);
            bench.send(node, &unlinked(place.interface.0, id))
        }
        Op::Wait(ms) => {
            bench.now = bench.now.after(Duration::from_millis(ms));
            oracle.wait(ms);
            bench.input(Input::Tick)
        }
        Op::Join(..) => Vec::new(),
    }
}

proptest! {
    #![proptest_config(cases(600))]

    //= SM2-RES-002, SM2-RES-003, SM2-RES-004, SM2-RES-005, SM2-RES-006, SM2-RES-007 test
    //= SM2-LNK-003, SM2-LNK-004, SM2-SES-004 test
    #[test]
    fn claims(seal_all in any::<bool>(), ops in vec(op(), 1..120)) {
        let policy = Policy { seal_all, ..UNLIMITED };
        let mut bench = Bench::new(policy);
        let observer = bench.node(9, "observer");
        let mut oracle = Oracle::default();
        let mut slots = [None; SLOTS];
        for op in ops {
            oracle.events.clear();
            let events = step(&mut bench, &mut oracle, &mut slots, &policy, op.clone());
            oracle.events.sort_unstable();
            prop_assert_eq!(&told(&events), &oracle.events, "{:?}", op);
            prop_assert_eq!(relations(&bench, observer), oracle.relations(), "{:?}", op);
        }
    }
}
