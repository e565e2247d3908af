//! A simulation: its gateways, and the random events that follow from the seed.

use std::collections::BTreeSet;

use sm2_gateway::{
    clock::{Clock, Now},
    hub::Room,
};
use sm2_io::quic::SecretKey;
use sm2_proto::{
    Instant,
    gateway::{GatewayId, Subject, SubjectKind},
};

use super::{
    domain::Nodes,
    ledger::Ledger,
    network::{Conditions, MS, Network},
    node::{Known, Node, Start, World},
    random::Random,
    rules::{RuleSet, subjects},
};

/// The epoch of a process whose clock is right, less the number of processes before.
pub(crate) const EPOCH: u64 = 1 << 32;
/// Events occur only at multiples of this time.
const TICK: u64 = MS / 10;
/// The bytes before the 32 bytes of an Ed25519 private key in PKCS#8 (RFC 8410).
const PKCS8_HEAD: [u8; 16] = [
    0x30, 0x2e, 0x02, 0x01, 0x00, 0x30, 0x05, 0x06, 0x03, 0x2b, 0x65, 0x70, 0x04, 0x22, 0x04, 0x20,
];

/// The descriptors of a subject with one publisher or server.
const SUBJECT_DESCRIPTORS: u64 = 6;
/// The subjects that a gateway which lacks descriptors still has some for.
pub(crate) const SHORT_OF: u64 = 3;

/// The number of gateways, and the pairs that trust each other.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Arrangement {
    Pair,
    /// A pair without descriptors for all subjects of a domain.
    ShortPair,
    Chain,
    Triangle,
    Ring,
}

impl Arrangement {
    const fn gateways(self) -> usize {
        match self {
            Self::Pair | Self::ShortPair => 2,
            Self::Chain | Self::Triangle => 3,
            Self::Ring => 4,
        }
    }

    const fn room(self) -> Room {
        match self {
            Self::ShortPair => Room {
                descriptors: SHORT_OF * SUBJECT_DESCRIPTORS,
                ..Room::UNLIMITED
            },
            Self::Pair | Self::Chain | Self::Triangle | Self::Ring => Room::UNLIMITED,
        }
    }

    fn links(self) -> &'static [(usize, usize)] {
        match self {
            Self::Pair | Self::ShortPair => &[(0, 1)],
            Self::Chain => &[(0, 1), (1, 2)],
            Self::Triangle => &[(0, 1), (1, 2), (2, 0)],
            Self::Ring => &[(0, 1), (1, 2), (2, 3), (3, 0)],
        }
    }
}

/// A gateway that runs, or one that has crashed and comes back later.
pub(crate) enum Place {
    Here(Box<Node>),
    Away { until: Instant, nodes: Nodes },
}

pub(crate) struct Simulation {
    pub(crate) now: Instant,
    pub(crate) random: Random,
    pub(crate) world: World,
    pub(crate) places: Vec<Place>,
    pub(crate) keys: Vec<SecretKey>,
    pub(crate) known: Vec<Vec<usize>>,
    addressed: BTreeSet<(usize, usize)>,
    pub(crate) cuts: Vec<(Instant, (usize, usize))>,
    next_op: Instant,
    is_scripted: bool,
    pub(crate) epoch: u64,
    pub(crate) subjects: Vec<Subject>,
    room: Room,
}

impl Simulation {
    pub(crate) fn new(arrangement: Arrangement, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let count = arrangement.gateways();
        let keys = (0..count).map(|_| {
            let bytes = [&PKCS8_HEAD[..], &random.bytes()].concat();
            SecretKey::from_pkcs8(&bytes).unwrap()
        });
        let keys: Vec<SecretKey> = keys.collect();
        let ids: Vec<GatewayId> = keys.iter().map(SecretKey::id).collect();
        let beacons = random.percent(30);
        let (mut links, mut addressed) = (BTreeSet::new(), BTreeSet::new());
        for &(one, other) in arrangement.links() {
            links.extend([(one, other), (other, one)]);
            let which = if beacons {
                random.below(4)
            } else {
                1 + random.below(3)
            };
            addressed.extend((which & 1 > 0).then_some((one, other)));
            addressed.extend((which & 2 > 0).then_some((other, one)));
        }
        let conditions = Conditions::any(&mut random);
        let start = Instant(1_000 * MS);
        let network = Network::new(random.fork(), conditions);
        let world = World {
            clock: Clock::new(Now {
                at: start,
                quic: std::time::Instant::now(),
            }),
            network,
            ledger: Ledger::new(ids, links.clone()),
            beacons,
        };
        let known = |node: usize| {
            (0..count)
                .filter(|it| links.contains(&(node, *it)))
                .collect()
        };
        let mut simulation = Self {
            now: start,
            random,
            world,
            places: Vec::new(),
            known: (0..count).map(known).collect(),
            keys,
            addressed,
            cuts: Vec::new(),
            next_op: start,
            is_scripted: true,
            epoch: 0,
            subjects: subjects(),
            room: arrangement.room(),
        };
        for index in 0..count {
            let nodes = simulation.any_nodes();
            let rules = RuleSet::any(&mut simulation.random, count);
            let node = simulation.node(index, rules, nodes);
            simulation.places.push(Place::Here(Box::new(node)));
        }
        simulation
    }

    fn any_nodes(&mut self) -> Nodes {
        let mut nodes = Nodes::default();
        for subject in &self.subjects {
            if self.random.percent(40) {
                nodes.present.insert(subject.clone());
            }
            if subject.kind() == SubjectKind::Topic && self.random.percent(60) {
                nodes
                    .takes
                    .insert(subject.clone(), 1 + (self.random.below(4) as u16));
            }
        }
        nodes
    }

    /// The epoch of a new process. The clock of each third one was set back.
    //= SM2-GWC-005 test
    const fn next_epoch(&mut self) -> u64 {
        self.epoch += 1;
        match self.epoch % 3 {
            0 => EPOCH - self.epoch,
            _ => EPOCH + self.epoch,
        }
    }

    fn node(&mut self, index: usize, rules: RuleSet, nodes: Nodes) -> Node {
        let epoch = self.next_epoch();
        let known = self.known[index].iter().map(|&peer| Known {
            index: peer,
            is_addressed: self.addressed.contains(&(index, peer)),
        });
        let start = Start {
            index,
            key: self.keys[index].clone(),
            epoch,
            known: known.collect(),
            rules,
            room: self.room,
            nodes,
            random: self.random.fork(),
        };
        Node::new(self.now, start, &mut self.world)
    }

    pub(crate) fn nodes(&mut self) -> impl Iterator<Item = &mut Node> {
        self.places.iter_mut().filter_map(|it| match it {
            Place::Here(node) => Some(&mut **node),
            Place::Away { .. } => None,
        })
    }

    pub(crate) fn node_and_world(&mut self, index: usize) -> (&mut Node, &mut World) {
        match &mut self.places[index] {
            Place::Here(node) => (node, &mut self.world),
            Place::Away { .. } => panic!("{index} is not there"),
        }
    }

    /// Runs the simulation for `millis` milliseconds.
    pub(crate) fn run(&mut self, millis: u64) {
        let end = Instant(self.now.0 + millis * MS);
        while let Some(next) = self.next_at().filter(|it| *it <= end) {
            let next = Instant(next.0.div_ceil(TICK) * TICK);
            self.now = self.now.max(next);
            self.step();
        }
        self.now = self.now.max(end);
    }

    /// Repairs the network, restarts all gateways, and ends the random events.
    pub(crate) fn heal(&mut self) {
        self.is_scripted = false;
        self.cuts.clear();
        self.world.network.cut.clear();
        self.world.network.conditions = Conditions::GOOD;
        for index in 0..self.places.len() {
            self.come_back(index);
        }
    }

    fn next_at(&mut self) -> Option<Instant> {
        let nodes = self.places.iter_mut().map(|it| match it {
            Place::Here(node) => node.deadline(),
            Place::Away { until, .. } => Some(*until),
        });
        let nodes = nodes.flatten().min();
        let network = self.world.network.next_at();
        let op = self.is_scripted.then_some(self.next_op);
        let cuts = self.cuts.iter().map(|(until, _)| *until).min();
        [nodes, network, op, cuts].into_iter().flatten().min()
    }

    fn step(&mut self) {
        let now = self.now;
        for index in 0..self.places.len() {
            if matches!(self.places[index], Place::Away { until, .. } if until <= now) {
                self.come_back(index);
            }
        }
        let (over, cuts) = (self.cuts.drain(..)).partition(|(until, _)| *until <= now);
        self.cuts = cuts;
        for (_, pair) in over as Vec<(Instant, (usize, usize))> {
            self.world.network.cut.remove(&pair);
        }
        while let Some(datagram) = self.world.network.arrived(now) {
            if let Place::Here(node) = &mut self.places[datagram.to] {
                node.datagram(now, &datagram, &mut self.world);
            }
        }
        if self.is_scripted && self.next_op <= now {
            self.op();
            self.next_op = Instant(now.0 + (1 + self.random.below(40)) * MS);
        }
        for place in &mut self.places {
            if let Place::Here(node) = place {
                node.turn(now, &mut self.world);
            }
        }
    }

    pub(crate) fn come_back(&mut self, index: usize) {
        let Place::Away { nodes, .. } = &self.places[index] else {
            return;
        };
        let nodes = nodes.clone();
        let rules = self.world.ledger.rules(index).clone();
        let node = self.node(index, rules, nodes);
        self.world.ledger.trace.add(self.now, index, "is back");
        self.places[index] = Place::Here(Box::new(node));
    }
}
