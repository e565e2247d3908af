//! Gateways that pass on what others offer, in any arrangement: who ends up with what.

mod support;

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use proptest::{collection::vec, prelude::*};
use sm2_proto::gateway::{
    Action, Direction, GatewayId, Hop, Pattern, Rule, Rules, Subject, SubjectKind,
    router::{Input, Output, Router, Source},
};
use sm2_proto::limits::HOPS_MAX;
use support::{
    cases,
    contracts::{data, name},
};

fn id(of: usize) -> GatewayId {
    GatewayId([of as u8; 32])
}

fn index(of: GatewayId) -> usize {
    of.0[0].into()
}

fn hop(of: usize) -> Hop {
    Hop {
        gateway: id(of),
        epoch: 7,
    }
}

fn path(of: &[usize]) -> Vec<Hop> {
    of.iter().map(|it| hop(*it)).collect()
}

fn topic(called: &str) -> Subject {
    Subject::Topic {
        name: name(called),
        data: data("Scan"),
        reliable: false,
        latched: 0,
    }
}

fn rule(action: Action, names: &str) -> Rule {
    Rule {
        action,
        kind: None,
        names: Pattern::new(names).unwrap(),
        direction: None,
        peers: None,
    }
}

fn open() -> Rules {
    Rules(vec![rule(Action::Allow, "**")])
}

/// Gateway 0 and what it is told.
struct Bench(Router);

impl Bench {
    fn new(rules: Rules, peers: &[usize]) -> Self {
        let mut bench = Self(Router::new(hop(0), rules));
        for peer in peers {
            assert_eq!(bench.input(Input::Up { peer: id(*peer) }), []);
        }
        bench
    }

    fn input(&mut self, input: Input) -> Vec<Output> {
        self.0.handle(input);
        std::iter::from_fn(|| self.0.poll()).collect()
    }

    fn local(&mut self, subject: &Subject, present: bool) -> Vec<Output> {
        let subject = subject.clone();
        self.input(Input::Local { subject, present })
    }

    fn offered(&mut self, offer: u64, way: &[usize]) -> Vec<Output> {
        self.input(Input::Offered {
            peer: id(*way.last().unwrap()),
            offer,
            subject: topic("a"),
            path: path(way),
        })
    }

    fn taken(&mut self, origin: usize, taken: Option<u16>) -> Vec<Output> {
        self.input(Input::Taken {
            subject: topic("a"),
            origin: id(origin),
            taken,
        })
    }

    fn wanted(&mut self, peer: usize, offer: u64, depth: Option<u16>) -> Vec<Output> {
        let peer = id(peer);
        self.input(match depth {
            Some(depth) => Input::Wanted { peer, offer, depth },
            None => Input::Unwanted { peer, offer },
        })
    }
}

fn offer(peer: usize, offer: u64, subject: &Subject, way: &[usize]) -> Output {
    Output::Offer {
        peer: id(peer),
        offer,
        subject: subject.clone(),
        path: path(way),
    }
}

fn unoffer(peer: usize, offer: u64) -> Output {
    let peer = id(peer);
    Output::Unoffer { peer, offer }
}

fn show(origin: usize, peer: usize) -> Output {
    Output::Show {
        subject: topic("a"),
        origin: id(origin),
        peer: id(peer),
    }
}

fn hide(origin: usize) -> Output {
    Output::Hide {
        subject: topic("a"),
        origin: id(origin),
    }
}

fn want(peer: usize, offer: u64, depth: u16) -> Output {
    let peer = id(peer);
    Output::Want { peer, offer, depth }
}

fn unwant(peer: usize, offer: u64) -> Output {
    let peer = id(peer);
    Output::Unwant { peer, offer }
}

#[test]
fn the_domain_is_asked_for_what_some_peer_wants() {
    let mut bench = Bench::new(open(), &[1, 2]);
    let subject = topic("a");
    let subscribe = |depth| Output::Subscribe {
        subject: topic("a"),
        depth,
    };
    let expected = [offer(1, 1, &subject, &[0]), offer(2, 1, &subject, &[0])];
    assert_eq!(bench.local(&subject, true), expected);
    assert_eq!(bench.local(&subject, true), []);
    assert_eq!(bench.wanted(1, 1, Some(3)), [subscribe(3)]);
    assert_eq!(bench.wanted(2, 1, Some(2)), []);
    let takers: Vec<_> = bench.0.takers(&subject, Source::Local).collect();
    assert_eq!(takers, [(id(1), 1), (id(2), 1)]);
    assert_eq!(bench.0.source(id(2), 1), Some((&subject, Source::Local)));
    assert_eq!(bench.0.source(id(2), 2), None);
    assert_eq!(bench.wanted(1, 1, None), [subscribe(2)]);
    let unsubscribe = Output::Unsubscribe {
        subject: subject.clone(),
    };
    assert_eq!(bench.wanted(2, 1, None), std::slice::from_ref(&unsubscribe));
    bench.wanted(2, 1, Some(1));
    assert_eq!(bench.wanted(2, 9, Some(1)), [], "no such offer");
    assert_eq!(
        bench.local(&subject, false),
        [unoffer(1, 1), unoffer(2, 1), unsubscribe]
    );
    assert_eq!(bench.wanted(2, 1, Some(1)), [], "it is withdrawn");
    let expected = [offer(1, 2, &subject, &[0]), offer(2, 2, &subject, &[0])];
    assert_eq!(bench.local(&subject, true), expected, "under a new number");
    // Who comes later is told as well.
    let up = bench.input(Input::Up { peer: id(3) });
    assert_eq!(up, [offer(3, 1, &subject, &[0])]);
}

//= SM2-GWO-004 test
#[test]
fn one_offer_of_each_origin_is_used() {
    let mut bench = Bench::new(open(), &[1, 2, 3]);
    let passed_on = |to: usize, number, way: &[usize]| offer(to, number, &topic("a"), way);
    let shown = bench.offered(1, &[5, 6, 2]);
    let expected = [
        passed_on(1, 1, &[5, 6, 2, 0]),
        passed_on(3, 1, &[5, 6, 2, 0]),
        show(5, 2),
    ];
    assert_eq!(shown, expected);
    assert_eq!(bench.taken(5, Some(4)), [want(2, 1, 4)]);
    // Longer, or as long from a greater id.
    assert_eq!(bench.offered(1, &[5, 6, 7, 1]), []);
    assert_eq!(bench.offered(1, &[5, 6, 3]), []);
    // As long from a smaller one: what was wanted by the old way is wanted by the new one, once
    // somebody takes what is shown now.
    let expected = [
        unoffer(1, 1),
        unoffer(3, 1),
        passed_on(2, 1, &[5, 6, 1, 0]),
        passed_on(3, 2, &[5, 6, 1, 0]),
        hide(5),
        unwant(2, 1),
        show(5, 1),
    ];
    assert_eq!(bench.offered(2, &[5, 6, 1]), expected);
    assert_eq!(bench.taken(5, Some(1)), [want(1, 2, 1)]);
    // A new process of the origin, by whatever way.
    let newer = Hop { epoch: 8, ..hop(5) };
    let outputs = bench.input(Input::Offered {
        peer: id(3),
        offer: 2,
        subject: topic("a"),
        path: vec![newer, hop(6), hop(7), hop(3)],
    });
    assert!(outputs.contains(&show(5, 3)), "{outputs:?}");
    // Its end leads back.
    let outputs = bench.input(Input::Gone {
        peer: id(3),
        offer: 2,
    });
    assert!(outputs.contains(&show(5, 1)), "{outputs:?}");
    // A number says one thing.
    assert_eq!(bench.offered(2, &[5, 1]), []);
    assert_eq!(
        bench.input(Input::Offered {
            peer: id(1),
            offer: 2,
            subject: topic("b"),
            path: path(&[1]),
        }),
        []
    );
    // Another origin is another matter.
    let outputs = bench.offered(9, &[8, 2]);
    assert!(outputs.contains(&show(8, 2)) && !outputs.contains(&hide(5)));
}

//= SM2-GWR-003 test
#[test]
fn rules_both_ways() {
    let only = |direction, peer| Rule {
        direction: Some(direction),
        peers: Some(vec![id(peer)]),
        ..rule(Action::Allow, "a")
    };
    let rules = Rules(vec![only(Direction::Out, 1), only(Direction::In, 2)]);
    let mut bench = Bench::new(rules, &[1, 2]);
    assert_eq!(bench.local(&topic("b"), true), []);
    let subject = topic("a");
    assert_eq!(bench.local(&subject, true), [offer(1, 1, &subject, &[0])]);
    assert_eq!(bench.offered(1, &[1]), [], "not from there");
    let expected = [offer(1, 2, &subject, &[2, 0]), show(2, 2)];
    assert_eq!(bench.offered(1, &[2]), expected);
    bench.wanted(1, 1, Some(1));
    assert_eq!(bench.wanted(1, 2, Some(1)), [want(2, 1, 1)]);
    // Other rules: what they do not allow ends at once.
    let outputs = bench.input(Input::Rules(Rules(vec![only(Direction::In, 1)])));
    let unsubscribe = Output::Unsubscribe {
        subject: subject.clone(),
    };
    let expected = [
        unoffer(1, 1),
        unoffer(1, 2),
        hide(2),
        unwant(2, 1),
        show(1, 1),
        unsubscribe,
    ];
    assert_eq!(outputs, expected);
}

//= SM2-GWO-003 test
#[test]
fn a_way_has_its_length() {
    let mut bench = Bench::new(open(), &[1, 2]);
    let way: Vec<usize> = (3..3 + HOPS_MAX - 1).chain([1]).collect();
    assert_eq!(way.len(), HOPS_MAX);
    let shown = [show(3, 1)];
    assert_eq!(bench.offered(1, &way), shown, "shown, and not passed on");
    let outputs = bench.offered(2, &way[1..]);
    assert_eq!(outputs.len(), 2, "passed on and shown: {outputs:?}");
}

#[test]
fn a_peer_that_is_gone_leaves_nothing() {
    let mut bench = Bench::new(open(), &[1, 2]);
    let before = bench.0.clone();
    bench.offered(1, &[3, 1]);
    bench.taken(3, Some(1));
    bench.wanted(2, 1, Some(1));
    let outputs = bench.input(Input::Down { peer: id(1) });
    assert_eq!(outputs, [unoffer(2, 1), hide(3)]);
    assert_eq!(bench.offered(1, &[3, 1]), [], "it has no connection");
    for input in [
        Input::Gone {
            peer: id(1),
            offer: 1,
        },
        Input::Down { peer: id(1) },
    ] {
        assert_eq!(bench.input(input), []);
    }
    bench.input(Input::Up { peer: id(1) });
    bench.input(Input::Down { peer: id(2) });
    bench.input(Input::Up { peer: id(2) });
    assert_eq!(bench.0, before);
}

/// What goes from one gateway to another.
#[derive(Clone, Debug)]
enum Said {
    Offer(u64, Vec<Hop>),
    Unoffer(u64),
    Want(u64, u16),
    Unwant(u64),
}

/// Gateways, and what is underway between them, in order.
struct World {
    routers: Vec<Router>,
    links: BTreeSet<(usize, usize)>,
    underway: BTreeMap<(usize, usize), VecDeque<Said>>,
    /// The offers that each knows: origin by peer and number.
    known: Vec<BTreeMap<(usize, u64), usize>>,
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
            underway: BTreeMap::new(),
            known: vec![BTreeMap::new(); count],
            local: vec![false; count],
            shown: vec![BTreeSet::new(); count],
            taken: vec![BTreeSet::new(); count],
            subscribed: vec![false; count],
        }
    }

    fn input(&mut self, at: usize, input: Input) {
        self.routers[at].handle(input);
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
                Output::Show { origin, .. } => {
                    assert!(self.shown[at].insert(index(origin)));
                    continue;
                }
                Output::Hide { origin, .. } => {
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
            self.underway.entry((at, peer)).or_default().push_back(said);
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
            self.underway.remove(&(at, peer));
            self.known[at].retain(|(of, _), _| *of != peer);
            self.input(at, Input::Down { peer: id(peer) });
        }
    }

    /// The next thing from one to the other arrives.
    fn arrive(&mut self, from: usize, at: usize) -> bool {
        let queue = self.underway.get_mut(&(from, at));
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

    /// A message is published in this domain: how often it comes to each gateway.
    fn publish(&self, origin: usize) -> Vec<usize> {
        let mut came = vec![0; self.routers.len()];
        let mut underway: VecDeque<(usize, Source)> = VecDeque::new();
        if self.subscribed[origin] {
            underway.push_back((origin, Source::Local));
        }
        while let Some((at, source)) = underway.pop_front() {
            for (peer, offer) in self.routers[at].takers(&topic("a"), source) {
                let peer = index(peer);
                assert_eq!(self.known[peer][&(at, offer)], origin);
                came[peer] += 1;
                assert!(came[peer] < 3, "it goes round");
                underway.push_back((peer, Source::Remote(id(origin))));
            }
        }
        came
    }

    /// How far it is from each to each.
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

    /// Only what is shown can be taken.
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

    /// Whoever takes what is published gets it, once; whoever does not, only to pass it on.
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

    /// Where nothing is forbidden, each gets what anybody has, by a shortest way, and whatever
    /// was said on the way there.
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
        // All of them take all.
        for (at, of) in pairs(5) {
            world.take(at, of, true);
        }
        world.quiet();
        world.check_messages();
    }

    /// Whatever the rules are: what a rule denies is neither offered nor used, and nothing goes
    /// round or comes twice.
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
