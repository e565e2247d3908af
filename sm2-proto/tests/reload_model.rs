//! Random policies for a domain that runs, compared with a Manager that had the last one all the time.

// Shows ACC-RELOAD (proptest), bound: sampled steps of up to six nodes, with the smallest parts of work, against a
// Manager that had the last policy all the time.

use std::collections::{BTreeMap, BTreeSet};

use crate::support::{
    access::{access, banning, deny, finish_work, snapshot, tables},
    bench::{Bench, Event, UNLIMITED, seen_by},
    cases,
    contracts::{data, publisher, subscriber},
};
use proptest::{collection::vec, prelude::*};
use sm2_proto::{
    Contract, Farewell, InterfaceId, LinkId, NodeId, Refusal,
    control::{Change, Item, Key, Limit, ToManager, ToNode},
    manager::Input,
    policy::{AccessPolicy, Action, Tables},
};

const USER: u32 = 5;

#[derive(Clone, Debug)]
enum Step {
    Connect(usize),
    Declare(usize, bool, usize),
    Withdraw(usize, usize),
    Close(usize),
    Confirm(usize),
    Tick,
    Reload([bool; 7]),
    Watch,
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        2 => (0..3_usize).prop_map(Step::Connect),
        8 => (0..6_usize, any::<bool>(), 0..2_usize)
            .prop_map(|(node, publishes, topic)| Step::Declare(node, publishes, topic)),
        1 => (0..6_usize, 0..4_usize).prop_map(|(node, which)| Step::Withdraw(node, which)),
        1 => (0..6_usize).prop_map(Step::Close),
        3 => (0..8_usize).prop_map(Step::Confirm),
        6 => Just(Step::Tick),
        3 => any::<[bool; 7]>().prop_map(Step::Reload),
        2 => Just(Step::Watch),
    ]
}

const GROUPS: [&str; 3] = ["arm", "leg", "head"];
const TOPICS: [&str; 2] = ["a", "b"];

/// A policy for each choice of what it denies.
fn chosen(choice: [bool; 7]) -> Tables {
    let [arm, leg, a, b, subscribing, ban, sight] = choice;
    let rules = [
        (arm, "arm", Action::Publish, "**", "arm/*"),
        (leg, "leg", Action::Subscribe, "**", "leg/*"),
        (a, "a", Action::Publish, "a", "**"),
        (b, "b", Action::Publish, "b", "head/*"),
        (subscribing, "all", Action::Subscribe, "b", "**"),
        (sight, "sight", Action::See, "arm/*", "guest"),
    ];
    let chosen = rules.into_iter().filter(|it| it.0);
    let rules =
        chosen.map(|(_, called, action, names, nodes)| deny(called, action, &[names], &[nodes]));
    let rules = rules.collect();
    match ban {
        true => Tables {
            rules,
            ..banning(&["head/*"])
        },
        false => tables(rules),
    }
}

fn contract(publishes: bool, topic: usize) -> Contract {
    match publishes {
        true => publisher(TOPICS[topic], &data("A")),
        false => subscriber(TOPICS[topic], None),
    }
}

/// A session of the test, with the interfaces that were granted to it.
struct Peer {
    node: NodeId,
    name: String,
    interfaces: BTreeMap<u64, (bool, usize)>,
}

/// An answer that a node owes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Asked {
    Unlink { link: LinkId, is_denied: bool },
    Suspension,
}

impl Asked {
    /// Whether the policy is not applied before the answer.
    const fn is_awaited(self) -> bool {
        matches!(
            self,
            Self::Suspension
                | Self::Unlink {
                    is_denied: true,
                    ..
                }
        )
    }
}

struct World {
    bench: Bench,
    guest: NodeId,
    peers: Vec<Peer>,
    /// The answers that the nodes owe.
    asked: Vec<(NodeId, InterfaceId, Asked)>,
    known: BTreeMap<Key, Item>,
    revision: u64,
    numbers: u64,
    tables: Tables,
}

impl World {
    fn new() -> Self {
        let mut bench = Bench::new(UNLIMITED.with(Limit::WorkPerTurn, 1));
        let guest = bench.node(USER, "guest");
        let known = snapshot(&mut bench, guest);
        Self {
            revision: bench.manager.revision(),
            bench,
            guest,
            peers: Vec::new(),
            asked: Vec::new(),
            known,
            numbers: 0,
            tables: tables(Vec::new()),
        }
    }

    /// Notes what the nodes have to answer, and which sessions are over.
    fn note(&mut self, events: &[Event]) {
        for event in events {
            match event {
                Event::Sent(
                    node,
                    ToNode::Unlink {
                        interface,
                        link,
                        code,
                    },
                ) => {
                    let is_denied = *code == Farewell::Denied.code();
                    let unlink = Asked::Unlink {
                        link: *link,
                        is_denied,
                    };
                    self.asked.push((*node, *interface, unlink));
                }
                Event::Sent(node, ToNode::DeclareRefused { interface, .. })
                    if self.has(*node, *interface) =>
                {
                    self.asked.push((*node, *interface, Asked::Suspension));
                }
                Event::HungUp(node, ..) => {
                    self.peers.retain(|it| it.node != *node);
                    self.asked.retain(|it| it.0 != *node);
                }
                _ => {}
            }
        }
    }

    fn confirm(&mut self, which: usize) -> Vec<Event> {
        let (node, interface, asked) = self.asked.remove(which);
        match asked {
            Asked::Unlink { link, .. } => self.bench.unlinked(node, interface.0, link),
            Asked::Suspension => self.bench.suspended(node, interface.0),
        }
    }

    /// Whether a node has this interface, also if it is suspended.
    fn has(&self, node: NodeId, interface: InterfaceId) -> bool {
        let mut peers = self.peers.iter().filter(|it| it.node == node);
        peers.any(|it| it.interfaces.contains_key(&interface.0))
    }

    fn step(&mut self, step: &Step) {
        self.numbers += 1;
        let number = self.numbers;
        let events = match *step {
            Step::Connect(group) => {
                let called = format!("{}/{number}", GROUPS[group]);
                let node = self.bench.connect(USER);
                let events = self.bench.hello(node, &called);
                let is_welcome = matches!(&events[..], [Event::Sent(_, ToNode::Welcome { .. })]);
                if is_welcome {
                    self.peers.push(Peer {
                        node,
                        name: called,
                        interfaces: BTreeMap::new(),
                    });
                }
                events
            }
            Step::Declare(at, publishes, topic) => {
                let Some(peer) = self.peers.get_mut(at) else {
                    return;
                };
                let contract = contract(publishes, topic);
                let events = self.bench.declare(peer.node, number, &contract);
                let interface = InterfaceId(number);
                let told = seen_by(&events, peer.node);
                if told.iter().any(
                    |it| matches!(it, ToNode::Declared { interface: it, .. } if *it == interface),
                ) {
                    peer.interfaces.insert(number, (publishes, topic));
                }
                events
            }
            Step::Withdraw(at, which) => {
                let Some(peer) = self.peers.get_mut(at) else {
                    return;
                };
                let Some(&interface) = peer.interfaces.keys().nth(which) else {
                    return;
                };
                peer.interfaces.remove(&interface);
                let node = peer.node;
                self.asked
                    .retain(|it| (it.0, it.1) != (node, InterfaceId(interface)));
                self.bench.withdraw(node, interface)
            }
            Step::Close(at) => {
                let Some(peer) = self.peers.get(at) else {
                    return;
                };
                self.bench.close(peer.node)
            }
            Step::Confirm(which) => {
                if which >= self.asked.len() {
                    return;
                }
                self.confirm(which)
            }
            Step::Tick => self.bench.input(Input::Tick),
            Step::Reload(choice) => {
                self.tables = chosen(choice);
                let policy = access(self.tables.clone());
                self.bench.input(Input::SetAccessPolicy(policy))
            }
            Step::Watch => return self.watch(),
        };
        self.note(&events);
    }

    /// Applies the changes since the last call, or reads all pages if they are not remembered.
    fn watch(&mut self) {
        while self.bench.manager.revision() != self.revision {
            let after = self.revision;
            let events = self.bench.send(self.guest, &ToManager::Watch { after });
            let mut frames = seen_by(&events, self.guest);
            let Some(ToNode::Changes(changes)) = frames.pop() else {
                panic!("{events:?}");
            };
            self.revision = changes.revision;
            let Some(changes) = changes.changes else {
                self.known = snapshot(&mut self.bench, self.guest);
                self.revision = self.bench.manager.revision();
                continue;
            };
            for change in changes {
                match change {
                    Change::Set { item } => drop(self.known.insert(item.key(), item)),
                    Change::Removed { key } => drop(self.known.remove(&key)),
                }
            }
        }
    }

    /// Lets all work be done and all nodes answer.
    fn run_until_quiet(&mut self) {
        loop {
            let events = finish_work(&mut self.bench);
            self.note(&events);
            let is_awaited = self.asked.iter().any(|it| it.2.is_awaited());
            assert_eq!(self.bench.manager.is_applying_policy(), is_awaited);
            if self.asked.is_empty() {
                return;
            }
            self.step(&Step::Confirm(0));
        }
    }

    /// The same sessions and interfaces at a new Manager that had this policy all the time.
    fn anew(&self) -> Bench {
        let mut bench = Bench::new(UNLIMITED);
        bench.manager = bench
            .manager
            .with_access_policy(AccessPolicy::new(self.tables.clone()).unwrap());
        for peer in &self.peers {
            let node = bench.node(USER, &peer.name);
            for (&number, &(publishes, topic)) in &peer.interfaces {
                bench.declare(node, number, &contract(publishes, topic));
            }
        }
        bench
    }
}

type Shown = (
    BTreeSet<[(String, u64); 2]>,
    BTreeMap<(String, u64), Option<Refusal>>,
);

/// The links and the interfaces by the names of their nodes, as an observer sees them.
fn domain(bench: &mut Bench) -> Shown {
    let observer = bench.node(USER, "observer");
    let items = snapshot(bench, observer);
    let names: BTreeMap<NodeId, String> = items
        .values()
        .filter_map(|it| match it {
            Item::Node { node, name, .. } => Some((*node, name.to_string())),
            _ => None,
        })
        .collect();
    let at = |it: &sm2_proto::EntityId| (names[&it.node].clone(), it.interface.0);
    let mut shown = Shown::default();
    for item in items.values() {
        match item {
            Item::Link {
                offering,
                demanding,
                ..
            } => drop(shown.0.insert([at(offering), at(demanding)])),
            Item::Interface { entity, .. } => drop(shown.1.insert(at(entity), None)),
            Item::Refusal { entity, reason, .. } => {
                shown.1.insert(at(entity), Some(reason.clone()));
            }
            _ => {}
        }
    }
    shown
}

proptest! {
    #![proptest_config(cases(300))]

    /// A Manager that gets another policy comes to the state that it would have if it had always
    /// had this policy: the same links, interfaces and reasons. Changes stay exact all along.
    //= SM2-ACC-013, SM2-ACC-014, SM2-ACC-010, SM2-WCH-003 test
    #[test]
    fn a_reload_leads_to_the_domain_of_the_new_policy(steps in vec(step(), 1..60)) {
        let mut world = World::new();
        for step in steps {
            world.step(&step);
            if matches!(step, Step::Watch) {
                let shown = snapshot(&mut world.bench, world.guest);
                prop_assert_eq!(&world.known, &shown);
            }
        }
        world.run_until_quiet();
        world.watch();
        let shown = snapshot(&mut world.bench, world.guest);
        prop_assert_eq!(&world.known, &shown);
        let (links, interfaces) = domain(&mut world.bench);
        let (expected_links, expected) = domain(&mut world.anew());
        prop_assert_eq!(links, expected_links);
        // Interfaces that were refused when they were declared are not there.
        let kept = interfaces.iter().filter(|(at, _)| expected.contains_key(at));
        prop_assert!(kept.eq(expected.iter()), "{:?} {:?}", interfaces, expected);
    }
}
