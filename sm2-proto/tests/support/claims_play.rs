//! Claims of a few sessions, honest and not, played to a Manager and to the oracle.

use std::{collections::BTreeSet, time::Duration};

use sm2_proto::{
    Contract, EntityId, InterfaceId, LinkId, Machine, NodeId,
    control::{Item, Key, Limits, Page, ToManager, ToNode},
    manager::Input,
};

use crate::{
    claims_oracle::{ConnectedNode, Oracle, Said, Told},
    support::bench::{Bench, EPOCH, Event, UNLIMITED, hello, resuming, unlinked, withdraw},
};

pub(crate) const SLOTS: usize = 4;
pub(crate) const INTERFACES: u64 = 3;

/// One action of a session. Sessions are named by their slot, interfaces by their number.
#[derive(Clone, Debug)]
pub(crate) enum Op {
    Join(usize, bool, u32),
    Leave(usize),
    Declare(usize, Contract),
    Withdraw(usize, u64),
    Claim(usize, u64, Said),
    Claimed(usize),
    /// UNLINKED for a link that the node has, or for one that it was told to end.
    Unlinked(usize, usize),
    Wait(u64),
}

/// A Manager, a node that only queries it, and the oracle of SPEC section 11.
pub(crate) struct Play {
    bench: Bench,
    observer: NodeId,
    oracle: Oracle,
    slots: [Option<NodeId>; SLOTS],
    limits: Limits,
}

impl Play {
    pub(crate) fn new(seal_all: bool) -> Self {
        let limits = Limits {
            seal_all,
            ..UNLIMITED
        };
        let mut bench = Bench::new(limits);
        let observer = bench.node(9, "observer");
        Self {
            bench,
            observer,
            oracle: Oracle::default(),
            slots: [None; SLOTS],
            limits,
        }
    }

    /// Applies one step to both. Panics if their outputs or their states differ.
    pub(crate) fn step(&mut self, op: &Op) {
        self.oracle.events.clear();
        let events = self.apply(op.clone());
        self.oracle.events.sort_unstable();
        assert_eq!(told(&events), self.oracle.events, "{op:?}");
        let shown = relations(&self.bench, self.observer);
        assert_eq!(shown, self.oracle.relations(), "{op:?}");
    }

    /// Applies one step to both. Returns the outputs of the Manager.
    fn apply(&mut self, op: Op) -> Vec<Event> {
        match op {
            Op::Join(at, resuming, uid) => self.join(at, resuming, uid),
            Op::Wait(ms) => self.wait(ms),
            Op::Leave(at)
            | Op::Declare(at, _)
            | Op::Withdraw(at, _)
            | Op::Claim(at, _, _)
            | Op::Claimed(at)
            | Op::Unlinked(at, _) => match self.session(at) {
                Some(session) => self.apply_to(&session, op),
                None => Vec::new(),
            },
        }
    }

    /// Executes one action of a session that exists.
    fn apply_to(&mut self, session: &ConnectedNode, op: Op) -> Vec<Event> {
        let node = session.node;
        match op {
            Op::Join(..) | Op::Wait(_) => Vec::new(),
            Op::Leave(_) => {
                self.oracle.leave(node);
                self.bench.close(node)
            }
            Op::Declare(_, contract) => self.declare(session, contract),
            Op::Withdraw(_, interface) => self.withdraw(node, interface),
            Op::Claim(_, interface, said) => self.claim(session, interface, said),
            Op::Claimed(_) => self.claimed(session),
            Op::Unlinked(_, pick) => self.unlinked(node, pick),
        }
    }

    fn session(&self, at: usize) -> Option<ConnectedNode> {
        let node = self.slots[at]?;
        self.oracle.sessions.get(&node).cloned()
    }

    fn join(&mut self, at: usize, is_resuming: bool, uid: u32) -> Vec<Event> {
        if self.session(at).is_some() {
            return Vec::new();
        }
        let text = format!("n{at}");
        let node = self.bench.connect(uid);
        let greeting = if is_resuming {
            resuming(&text)
        } else {
            hello(&text)
        };
        self.bench.send(node, &greeting);
        self.slots[at] = Some(node);
        self.oracle.sessions.insert(
            node,
            ConnectedNode {
                node,
                uid,
                resuming: is_resuming,
                last: 0,
                greet_until: self.oracle.now + 2_000,
            },
        );
        Vec::new()
    }

    fn declare(&mut self, session: &ConnectedNode, contract: Contract) -> Vec<Event> {
        let node = session.node;
        let interface = session.last + 1;
        if interface > INTERFACES {
            return Vec::new();
        }
        let entity = entity_of(node, interface);
        self.oracle.interfaces.insert(entity, contract.clone());
        if let Some(session) = self.oracle.sessions.get_mut(&node) {
            session.last = interface;
        }
        let events = self.bench.declare(node, interface, &contract);
        let matches = if session.resuming {
            0
        } else {
            self.oracle.link_all(&self.limits, entity)
        };
        let answer = ToNode::Declared {
            interface: entity.interface,
            matches: u32::try_from(matches).expect("few"),
        };
        assert_eq!(events[0], Event::Sent(node, answer));
        events
    }

    fn withdraw(&mut self, node: NodeId, interface: u64) -> Vec<Event> {
        let entity = entity_of(node, interface);
        if self.oracle.interfaces.remove(&entity).is_none() {
            return Vec::new();
        }
        self.oracle.drop_end(entity, None, 0);
        self.bench.send(node, &withdraw(interface))
    }

    fn claim(&mut self, session: &ConnectedNode, interface: u64, said: Said) -> Vec<Event> {
        let entity = entity_of(session.node, interface);
        let link = LinkId {
            epoch: EPOCH - 1,
            serial: said.serial,
        };
        let is_legal = session.resuming
            && self.oracle.interfaces.contains_key(&entity)
            && !self.oracle.has(entity, link);
        if !is_legal {
            return Vec::new();
        }
        let frame = ToManager::Claim {
            interface: entity.interface,
            link,
            key: said.key,
            version: 1,
            reliable: said.reliable,
            sealed: said.sealed,
        };
        self.oracle.claim(&self.limits, entity, link, said);
        self.bench.send(session.node, &frame)
    }

    fn claimed(&mut self, session: &ConnectedNode) -> Vec<Event> {
        if !session.resuming {
            return Vec::new();
        }
        let node = session.node;
        if let Some(session) = self.oracle.sessions.get_mut(&node) {
            session.resuming = false;
        }
        for half in &mut self.oracle.halves {
            if half.entity.node == node {
                half.until = Some(self.oracle.now + 5_000);
            }
        }
        let entities: Vec<EntityId> = self.oracle.interfaces.keys().copied().collect();
        for entity in entities.into_iter().filter(|it| it.node == node) {
            self.oracle.link_all(&self.limits, entity);
        }
        self.bench.send(node, &ToManager::Claimed)
    }

    fn unlinked(&mut self, node: NodeId, pick: usize) -> Vec<Event> {
        let oracle = &mut self.oracle;
        let mut own: BTreeSet<(EntityId, LinkId)> = oracle.told.clone();
        own.extend(oracle.halves.iter().map(|it| (it.entity, it.id)));
        let links = oracle.links.iter();
        own.extend(links.flat_map(|it| it.ends.map(|end| (end, it.id))));
        own.retain(|(entity, _)| entity.node == node);
        let Some(&(entity, id)) = own.iter().nth(pick) else {
            return Vec::new();
        };
        if !oracle.told.contains(&(entity, id)) {
            oracle.events.push((entity, id, Some(5)));
        }
        oracle.drop_end(entity, Some(id), 5);
        self.bench.send(node, &unlinked(entity.interface.0, id))
    }

    fn wait(&mut self, ms: u64) -> Vec<Event> {
        let now = self.bench.now;
        self.bench.now = now.after(Duration::from_millis(ms));
        self.oracle.wait(ms);
        let mut events = self.bench.input(Input::Tick);
        // Each Tick does the work of one session (SM2-SES-009).
        while (self.bench.manager.deadline()).is_some_and(|it| it <= self.bench.now) {
            events.extend(self.bench.input(Input::Tick));
        }
        events
    }
}

const fn entity_of(node: NodeId, interface: u64) -> EntityId {
    EntityId {
        node,
        interface: InterfaceId(interface),
    }
}

/// All LINKs and UNLINKs that the Manager sent.
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
            ToNode::Page(Page {
                items, next: None, ..
            }),
        ),
    ] = &events[..]
    else {
        panic!("{events:?}");
    };
    let related = |item: &&Item| !matches!(item, Item::Unlinked { .. });
    items.iter().filter(related).cloned().collect()
}
