//! Claims of a few sessions, honest and not, played to a Manager and to the oracle.

use std::{collections::BTreeSet, time::Duration};

use sm2_proto::{
    Contract, EntityId, InterfaceId, LinkId, NodeId,
    control::{Item, Key, ToManager, ToNode},
    manager::{Input, Policy},
};

use crate::{
    claims_oracle::{Oracle, Said, Session, Told},
    support::bench::{Bench, EPOCH, Event, UNLIMITED, hello, resuming, unlinked, withdraw},
};

pub(crate) const SLOTS: usize = 4;
pub(crate) const INTERFACES: u64 = 3;

/// What one session does; sessions and interfaces by their place in the play.
#[derive(Clone, Debug)]
pub(crate) enum Op {
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

/// A Manager, somebody who only looks, and what SPEC makes of it all.
pub(crate) struct Play {
    bench: Bench,
    observer: NodeId,
    oracle: Oracle,
    slots: [Option<NodeId>; SLOTS],
    policy: Policy,
}

impl Play {
    pub(crate) fn new(seal_all: bool) -> Self {
        let policy = Policy {
            seal_all,
            ..UNLIMITED
        };
        let mut bench = Bench::new(policy);
        let observer = bench.node(9, "observer");
        Self {
            bench,
            observer,
            oracle: Oracle::default(),
            slots: [None; SLOTS],
            policy,
        }
    }

    /// Does one thing to both. Panics if they say or show different things.
    pub(crate) fn step(&mut self, op: &Op) {
        let Self {
            bench,
            oracle,
            slots,
            policy,
            ..
        } = self;
        oracle.events.clear();
        let events = step(bench, oracle, slots, policy, op.clone());
        oracle.events.sort_unstable();
        assert_eq!(told(&events), oracle.events, "{op:?}");
        let shown = relations(bench, self.observer);
        assert_eq!(shown, oracle.relations(), "{op:?}");
    }
}

/// What the Manager told everybody of links.
fn told(events: &[Event]) -> Vec<Told> {
    let one = |node: NodeId, frame: &ToNode| match *frame {
        ToNode::Unlink {
            interface,
            link,
            code,
        } => Some((EntityId { node, interface }, link, Some(code.0))),
        ToNode::Link {
            interface, link, ..
        } => Some((EntityId { node, interface }, link, None)),
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
        entity: EntityId {
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
    let related = |item: &&Item| !matches!(item, Item::Unlinked { .. });
    items.iter().filter(related).cloned().collect()
}

/// What the Manager said.
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
    let entity_of = |node: NodeId, interface: u64| EntityId {
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
                let entity = entity_of(node, last + 1);
                oracle.interfaces.insert(entity, contract.clone());
                if let Some(session) = oracle.sessions.get_mut(&node) {
                    session.last += 1;
                }
                let events = bench.declare(node, last + 1, &contract);
                let matches = if resuming {
                    0
                } else {
                    oracle.link_all(policy, entity)
                };
                let answer = ToNode::Declared {
                    interface: entity.interface,
                    matches: u32::try_from(matches).expect("few"),
                };
                assert_eq!(events[0], Event::Sent(node, answer));
                events
            }
            _ => Vec::new(),
        },
        Op::Withdraw(at, interface) => match session(oracle, at) {
            Some(Session { node, .. })
                if oracle.interfaces.contains_key(&entity_of(node, interface)) =>
            {
                let entity = entity_of(node, interface);
                oracle.interfaces.remove(&entity);
                oracle.drop_end(entity, None, 0);
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
                }) if oracle.interfaces.contains_key(&entity_of(node, interface))
                    && !oracle.has(entity_of(node, interface), id) =>
                {
                    oracle.claim(policy, entity_of(node, interface), id, said);
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
                    if half.entity.node == node {
                        half.until = Some(oracle.now + 5_000);
                    }
                }
                let entities: Vec<EntityId> = oracle.interfaces.keys().copied().collect();
                for entity in entities.into_iter().filter(|it| it.node == node) {
                    oracle.link_all(policy, entity);
                }
                bench.send(node, &ToManager::Claimed)
            }
            _ => Vec::new(),
        },
        Op::Unlinked(at, pick) => {
            let Some(Session { node, .. }) = session(oracle, at) else {
                return Vec::new();
            };
            let mut own: BTreeSet<(EntityId, LinkId)> = oracle.told.clone();
            own.extend(oracle.halves.iter().map(|it| (it.entity, it.id)));
            own.extend(
                oracle
                    .links
                    .iter()
                    .flat_map(|it| it.ends.map(|end| (end, it.id))),
            );
            own.retain(|(entity, _)| entity.node == node);
            let Some(&(entity, id)) = own.iter().nth(pick) else {
                return Vec::new();
            };
            if !oracle.told.contains(&(entity, id)) {
                oracle.events.push((entity, id, Some(5)));
            }
            oracle.drop_end(entity, Some(id), 5);
            bench.send(node, &unlinked(entity.interface.0, id))
        }
        Op::Wait(ms) => {
            bench.now = bench.now.after(Duration::from_millis(ms));
            oracle.wait(ms);
            bench.input(Input::Tick)
        }
        Op::Join(..) => Vec::new(),
    }
}
