//! Several routers in any arrangement, and the messages in flight between them.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use proptest::{collection::vec, prelude::*};
use sm2_proto::{
    Instant, Machine,
    gateway::{
        Action, Direction, Hop, OfferId, Rule, Rules, SubjectKind,
        router::{Input, Output, Router, Source},
    },
};

use super::{hop, id, index, open, rule, topic};
use crate::support::{cases, contracts::name};

/// A message from one router to another.
#[derive(Clone, Debug)]
enum Said {
    Offer(OfferId, Vec<Hop>),
    Unoffer(OfferId),
    Want(OfferId, u16),
    Unwant(OfferId),
}

/// Routers and the messages in flight between them, in order.
struct World {
    routers: Vec<Router>,
    links: BTreeSet<(usize, usize)>,
    in_flight: BTreeMap<(usize, usize), VecDeque<Said>>,
    /// The origins of the offers that each router knows, by peer and number.
    known: Vec<BTreeMap<(usize, OfferId), usize>>,
    local: Vec<bool>,
    shown: Vec<BTreeSet<usize>>,
    taken: Vec<BTreeSet<usize>>,
    subscribed: Vec<bool>,
}

impl World {
    fn new(rules: Vec<Rules>) -> Self {
        let count = rules.len();
        let routers = rules.into_iter().enumerate();
        Self {
            routers: routers
                .map(|(at, rules)| Router::new(hop(at), rules))
                .collect(),
            links: BTreeSet::new(),
            in_flight: BTreeMap::new(),
            known: vec![BTreeMap::new(); count],
            local: vec![false; count],
            shown: vec![BTreeSet::new(); count],
            taken: vec![BTreeSet::new(); count],
            subscribed: vec![false; count],
        }
    }

    fn input(&mut self, at: usize, input: Input) {
        let Ok(()) = self.routers[at].handle(Instant(0), input);
        while let Some(output) = self.routers[at].poll() {
            let (peer, said) = match output {
                Output::Offer {
                    peer, offer, path, ..
                } => {
                    assert!(!path.iter().any(|it| it.gateway == peer), "{path:?}");
                    assert_eq!(path.last(), Some(&hop(at)));
                    (peer, Said::Offer(offer, path))
                }
                Output::Unoffer { peer, offer } => (peer, Said::Unoffer(offer)),
                Output::Want { peer, offer, depth } => (peer, Said::Want(offer, depth)),
                Output::Unwant { peer, offer } => (peer, Said::Unwant(offer)),
                Output::DeclareProxy { origin, .. } => {
                    assert!(self.shown[at].insert(index(origin)));
                    continue;
                }
                Output::WithdrawProxy { origin, .. } => {
                    assert!(self.shown[at].remove(&index(origin)));
                    self.taken[at].remove(&index(origin));
                    continue;
                }
                Output::Subscribe { .. } => {
                    self.subscribed[at] = true;
                    continue;
                }
                Output::Unsubscribe { .. } => {
                    assert!(std::mem::take(&mut self.subscribed[at]));
                    continue;
                }
            };
            let peer = index(peer);
            assert!(self.is_linked(at, peer), "{said:?}");
            self.in_flight
                .entry((at, peer))
                .or_default()
                .push_back(said);
        }
    }

    fn is_linked(&self, one: usize, other: usize) -> bool {
        self.links.contains(&(one.min(other), one.max(other)))
    }

    fn link(&mut self, one: usize, other: usize) {
        if one == other || !self.links.insert((one.min(other), one.max(other))) {
            return;
        }
        for (at, peer) in [(one, other), (other, one)] {
            self.input(at, Input::Up { peer: id(peer) });
        }
    }

    fn cut(&mut self, one: usize, other: usize) {
        if !self.links.remove(&(one.min(other), one.max(other))) {
            return;
        }
        for (at, peer) in [(one, other), (other, one)] {
            self.in_flight.remove(&(at, peer));
            self.known[at].retain(|(of, _), _| *of != peer);
            self.input(at, Input::Down { peer: id(peer) });
        }
    }

    /// Delivers the next message from one router to the other. False if there is none.
    fn arrive(&mut self, from: usize, at: usize) -> bool {
        let queue = self.in_flight.get_mut(&(from, at));
        let Some(said) = queue.and_then(VecDeque::pop_front) else {
            return false;
        };
        let peer = id(from);
        let input = match said {
            Said::Offer(offer, path) => {
                self.known[at].insert((from, offer), index(path[0].gateway));
                let subject = topic("a");
                Input::Offered {
                    peer,
                    offer,
                    subject,
                    path,
                }
            }
            Said::Unoffer(offer) => {
                self.known[at].remove(&(from, offer));
                Input::Gone { peer, offer }
            }
            Said::Want(offer, depth) => Input::Wanted { peer, offer, depth },
            Said::Unwant(offer) => Input::Unwanted { peer, offer },
        };
        self.input(at, input);
        true
    }

    fn quiet(&mut self) {
        let all: Vec<(usize, usize)> = pairs(self.routers.len()).collect();
        for _ in 0..10_000 {
            let arrived = all.iter().filter(|(from, at)| self.arrive(*from, *at));
            if arrived.count() == 0 {
                return;
            }
        }
        panic!("it never ends");
    }

    /// How often each gateway receives a message that is published in this domain.
    fn publish(&self, origin: usize) -> Vec<usize> {
        let mut came = vec![0; self.routers.len()];
        let mut in_flight: VecDeque<(usize, Source)> = VecDeque::new();
        if self.subscribed[origin] {
            in_flight.push_back((origin, Source::Local));
        }
        while let Some((at, source)) = in_flight.pop_front() {
            for (peer, offer) in self.routers[at].takers(&topic("a"), source) {
                let peer = index(peer);
                assert_eq!(self.known[peer][&(at, offer)], origin);
                came[peer] += 1;
                assert!(came[peer] < 3, "it goes round");
                in_flight.push_back((peer, Source::Remote(id(origin))));
            }
        }
        came
    }

    /// The distances between all gateways, in links.
    fn distances(&self) -> BTreeMap<(usize, usize), usize> {
        let count = self.routers.len();
        let mut all = BTreeMap::new();
        for start in 0..count {
            let mut next = VecDeque::from([(start, 0)]);
            while let Some((at, far)) = next.pop_front() {
                if all.contains_key(&(start, at)) {
                    continue;
                }
                all.insert((start, at), far);
                let linked = (0..count).filter(|peer| self.is_linked(at, *peer));
                next.extend(linked.map(|peer| (peer, far + 1)));
            }
        }
        all
    }
}

fn pairs(count: usize) -> impl Iterator<Item = (usize, usize)> {
    let all = (0..count).flat_map(move |from| (0..count).map(move |at| (from, at)));
    all.filter(|(from, at)| from != at)
}

#[derive(Clone, Copy, Debug)]
enum Op {
    Link(usize, usize),
    Cut(usize, usize),
    Local(usize, bool),
    Taken(usize, usize, bool),
    Arrive(usize, usize),
}

fn op(count: usize) -> impl Strategy<Value = Op> {
    let one = 0..count;
    let two = (one.clone(), one.clone());
    prop_oneof![
        3 => two.clone().prop_map(|(one, other)| Op::Link(one, other)),
        1 => two.clone().prop_map(|(one, other)| Op::Cut(one, other)),
        2 => (one, any::<bool>()).prop_map(|(at, present)| Op::Local(at, present)),
        4 => (two.clone(), any::<bool>()).prop_map(|((at, of), taken)| Op::Taken(at, of, taken)),
        20 => two.prop_map(|(from, at)| Op::Arrive(from, at)),
    ]
}

impl World {
    fn step(&mut self, op: Op) {
        match op {
            Op::Link(one, other) => self.link(one, other),
            Op::Cut(one, other) => self.cut(one, other),
            Op::Local(at, present) => {
                self.local[at] = present;
                let subject = topic("a");
                self.input(at, Input::Local { subject, present });
            }
            Op::Taken(at, of, taken) => self.take(at, of, taken),
            Op::Arrive(from, at) => {
                self.arrive(from, at);
            }
        }
    }

    /// A gateway takes an origin only while it is shown.
    fn take(&mut self, at: usize, of: usize, taken: bool) {
        if !self.shown[at].contains(&of) {
            return;
        }
        match taken {
            true => self.taken[at].insert(of),
            false => self.taken[at].remove(&of),
        };
        let taken = taken.then_some(1);
        let (subject, origin) = (topic("a"), id(of));
        self.input(
            at,
            Input::Taken {
                subject,
                origin,
                taken,
            },
        );
    }

    /// Each gateway that takes an origin receives its messages once. Others receive them only to pass
    /// them on.
    fn check_messages(&self) {
        for origin in 0..self.routers.len() {
            let came = self.publish(origin);
            assert_eq!(came[origin], 0, "it comes back");
            let mut somebody = false;
            for (at, came) in came.iter().enumerate() {
                let takes = self.taken[at].contains(&origin) && self.local[origin];
                somebody |= takes;
                assert!(*came <= 1, "gateway {at} has it {came} times from {origin}");
                assert!(!takes || *came == 1, "gateway {at} misses it from {origin}");
            }
            assert_eq!(self.subscribed[origin], somebody, "from {origin}");
        }
    }
}

proptest! {
    #![proptest_config(cases(300))]

    /// If the rules allow everything, each gateway gets the subjects of all others by a shortest path,
    /// in any order of events.
    //= SM2-GWO-003, SM2-GWO-004 test
    #[test]
    fn each_gets_what_there_is(ops in vec(op(5), 0..150)) {
        let mut world = World::new(vec![open(); 5]);
        for op in ops {
            world.step(op);
        }
        world.quiet();
        let distances = world.distances();
        for (at, of) in pairs(5) {
            let is_there = world.local[of] && distances.contains_key(&(at, of));
            prop_assert_eq!(world.shown[at].contains(&of), is_there, "{} of {}", at, of);
        }
        world.check_messages();
        // Every gateway takes every origin.
        for (at, of) in pairs(5) {
            world.take(at, of, true);
        }
        world.quiet();
        world.check_messages();
    }

    /// Under any rules, no denied subject is offered or used, no message returns to its origin, and
    /// none is received twice.
    //= SM2-GWR-003, SM2-GWO-003, SM2-GWO-004 test
    #[test]
    fn no_rule_is_passed_by(denied in vec((0_usize..5, 0_usize..5, any::<bool>()), 0..8), ops in vec(op(5), 0..120)) {
        let rules = |at: usize| {
            let of = denied.iter().filter(|(whose, _, _)| *whose == at);
            let deny = of.map(|(_, peer, outward)| Rule {
                direction: Some(if *outward { Direction::Out } else { Direction::In }),
                peers: Some(vec![id(*peer)]),
                ..rule(Action::Deny, "**")
            });
            Rules(deny.chain(open().0).collect())
        };
        let all: Vec<Rules> = (0..5).map(rules).collect();
        let mut world = World::new(all.clone());
        for op in ops {
            world.step(op);
        }
        world.quiet();
        for (at, of) in pairs(5) {
            world.take(at, of, true);
        }
        world.quiet();
        world.check_messages();
        for (at, peer) in pairs(5) {
            let allow = |direction| {
                all[at].allow(SubjectKind::Topic, &name("a"), direction, &id(peer))
            };
            if !allow(Direction::Out) {
                prop_assert!(world.known[peer].keys().all(|(of, _)| *of != at), "{at} to {peer}");
            }
            if !allow(Direction::In) {
                let subject = topic("a");
                let mut sources = (0..5).map(|it| Source::Remote(id(it))).chain([Source::Local]);
                let wants = sources.any(|it| {
                    world.routers[peer].takers(&subject, it).any(|(to, _)| to == id(at))
                });
                prop_assert!(!wants, "{at} wants from {peer}");
            }
        }
    }
}
