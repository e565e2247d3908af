//! Many sources, updated in pieces.

use std::collections::{BTreeMap, BTreeSet};

use proptest::{collection::vec, prelude::*};
use sm2_proto::{
    Instant, Machine,
    gateway::{
        Action, Direction, GatewayId, Hop, OfferId, Rule, Rules, Subject,
        router::{Input, Output, PIECE_DECISIONS, Router, Source},
    },
    limits::OFFERS_MAX,
};

use super::{Bench, hop, id, open, path, rule, topic};
use crate::support::cases;

/// How many peers offer as much as a peer may.
pub(crate) const PEERS: usize = 4;

fn deny() -> Rules {
    Rules(vec![rule(Action::Deny, "**")])
}

pub(crate) fn ticks(bench: &mut Bench) -> Vec<Vec<Output>> {
    let mut pieces = Vec::new();
    while bench.0.deadline().is_some() {
        pieces.push(bench.input(Input::Tick));
    }
    pieces
}

/// Gateway 0 with 16,384 routes, all of them wanted by the other peers. If `is_one` is true, they belong to one
/// subject, each with an origin of its own.
pub(crate) fn crowd(is_one: bool) -> (Bench, Vec<(GatewayId, OfferId)>) {
    let mut bench = Bench::new(open(), &[1, 2, 3, 4]);
    let mut own_offers = Vec::new();
    for number in 0..PEERS * OFFERS_MAX {
        let peer = hop(1 + number / OFFERS_MAX);
        let mut origin = hop(100);
        origin.gateway.0[..8].copy_from_slice(&number.to_le_bytes());
        origin.gateway.0[8] = 1;
        let subject = match is_one {
            true => topic("a"),
            false => topic(&format!("a{number}")),
        };
        let outputs = bench.input(Input::Offered {
            peer: peer.gateway,
            offer: OfferId(1 + (number % OFFERS_MAX) as u64),
            subject,
            path: vec![origin, peer],
        });
        for output in outputs {
            if let Output::Offer { peer, offer, .. } = output {
                own_offers.push((peer, offer));
            }
        }
    }
    assert_eq!(own_offers.len(), PEERS * OFFERS_MAX * (PEERS - 1));
    for &(peer, offer) in own_offers.iter().step_by(PEERS - 1) {
        let depth = 1;
        let outputs = bench.input(Input::Wanted { peer, offer, depth });
        assert_eq!(outputs.len(), 1, "{outputs:?}");
    }
    (bench, own_offers)
}

/// Counts the outputs that `is_it` selects.
pub(crate) fn count(pieces: &[Vec<Output>], is_it: fn(&&Output) -> bool) -> usize {
    pieces.iter().flatten().filter(is_it).count()
}

//= SM2-GWR-004 test
#[test]
fn other_rules_are_applied_in_bounded_pieces() {
    for is_one in [false, true] {
        let (mut bench, own_offers) = crowd(is_one);
        let mut pieces = vec![bench.input(Input::Rules(deny()))];
        pieces.extend(ticks(&mut bench));
        // A source costs at most 1 + 1 + 3 + 4 decisions, and makes at most 3 + 2 outputs.
        let longest = pieces.iter().map(Vec::len).max();
        assert!(longest <= Some(PIECE_DECISIONS), "{longest:?}");
        let routes = PEERS * OFFERS_MAX;
        let unoffers = count(&pieces, |it| matches!(it, Output::Unoffer { .. }));
        assert_eq!(unoffers, own_offers.len());
        let unwants = count(&pieces, |it| matches!(it, Output::Unwant { .. }));
        assert_eq!(unwants, routes);
        let hidden = count(&pieces, |it| matches!(it, Output::WithdrawProxy { .. }));
        assert_eq!(hidden, routes);
        assert_eq!(bench.0.deadline(), None);
    }
}

/// Each UNWANT concerns one source. If it updated all sources of its subject, this test would take hours.
#[test]
fn an_unwant_ends_one_want_of_many_origins() {
    let (mut bench, own_offers) = crowd(true);
    for &(peer, offer) in own_offers.iter().step_by(PEERS - 1) {
        let outputs = bench.input(Input::Unwanted { peer, offer });
        assert!(
            matches!(outputs[..], [Output::Unwant { .. }]),
            "{outputs:?}"
        );
    }
}

/// A peer that connects again and again does not keep the router from updating every source.
//= SM2-GWR-004 test
#[test]
fn connections_do_not_hold_up_other_rules() {
    let (mut bench, own_offers) = crowd(false);
    let mut withdrawn = BTreeSet::new();
    let mut note = |outputs: Vec<Output>| {
        for output in outputs {
            if let Output::Unoffer { peer, offer } = output {
                assert!(withdrawn.insert((peer, offer)), "withdrawn twice");
            }
        }
        withdrawn.len()
    };
    note(bench.input(Input::Rules(deny())));
    let mut rounds = 0;
    while note(bench.input(Input::Tick)) < own_offers.len() {
        note(bench.input(Input::Up { peer: id(9) }));
        rounds += 1;
        assert!(rounds < own_offers.len() / 100, "no progress");
    }
}

/// One change of the facts.
#[derive(Clone, Debug)]
enum Step {
    Rules(Vec<(bool, usize, Option<usize>, Option<bool>)>),
    Up(usize),
    Down(usize),
    Local(usize, bool),
    Taken(usize, usize, Option<u16>),
    Offered(usize, u64, usize, usize),
    Gone(usize, u64),
    Wanted(usize, u64, Option<u16>),
    Use(usize, Option<usize>),
    Tick,
}

fn steps() -> impl Strategy<Value = Vec<Step>> {
    let depth = || prop::option::of(1..4_u16);
    let rule = (
        any::<bool>(),
        0..5_usize,
        prop::option::of(1..4_usize),
        any::<Option<bool>>(),
    );
    vec(
        prop_oneof![
            2 => vec(rule, 0..4).prop_map(Step::Rules),
            1 => (1..4_usize).prop_map(Step::Up),
            1 => (1..4_usize).prop_map(Step::Down),
            2 => (0..4_usize, any::<bool>()).prop_map(|(of, is)| Step::Local(of, is)),
            3 => (0..4_usize, 5..8_usize, depth()).prop_map(|(of, origin, it)| Step::Taken(of, origin, it)),
            5 => (1..4_usize, 1..9_u64, 0..4_usize, 5..8_usize)
                .prop_map(|(peer, offer, of, origin)| Step::Offered(peer, offer, of, origin)),
            1 => (1..4_usize, 1..9_u64).prop_map(|(peer, offer)| Step::Gone(peer, offer)),
            5 => (1..4_usize, 1..9_u64, depth()).prop_map(|(peer, offer, it)| Step::Wanted(peer, offer, it)),
            2 => (0..4_usize, prop::option::of(5..8_usize)).prop_map(|(of, origin)| Step::Use(of, origin)),
            3 => Just(Step::Tick),
        ],
        0..60,
    )
}

fn subject(of: usize) -> Subject {
    topic(&format!("t{of}"))
}

fn input(step: Step) -> Input {
    match step {
        Step::Rules(rules) => {
            let rule = |(allow, of, peer, out): (bool, usize, Option<usize>, Option<bool>)| Rule {
                direction: out.map(|it| if it { Direction::Out } else { Direction::In }),
                peers: peer.map(|it| vec![id(it)]),
                ..rule(
                    if allow { Action::Allow } else { Action::Deny },
                    if of == 4 {
                        "**".to_owned()
                    } else {
                        format!("t{of}")
                    }
                    .as_str(),
                )
            };
            Input::Rules(Rules(rules.into_iter().map(rule).chain(open().0).collect()))
        }
        Step::Up(peer) => Input::Up { peer: id(peer) },
        Step::Down(peer) => Input::Down { peer: id(peer) },
        Step::Local(of, present) => Input::Local {
            subject: subject(of),
            present,
        },
        Step::Taken(of, origin, taken) => Input::Taken {
            subject: subject(of),
            origin: id(origin),
            taken,
        },
        Step::Offered(peer, offer, of, origin) => Input::Offered {
            peer: id(peer),
            offer: OfferId(offer),
            subject: subject(of),
            path: path(&[origin, peer]),
        },
        Step::Gone(peer, offer) => Input::Gone {
            peer: id(peer),
            offer: OfferId(offer),
        },
        Step::Wanted(peer, offer, depth) => {
            let (peer, offer) = (id(peer), OfferId(offer));
            match depth {
                Some(depth) => Input::Wanted { peer, offer, depth },
                None => Input::Unwanted { peer, offer },
            }
        }
        Step::Use(of, origin) => Input::Use {
            subject: subject(of),
            source: origin.map_or(Source::Local, |it| Source::Remote(id(it))),
        },
        Step::Tick => Input::Tick,
    }
}

/// The facts that the inputs and outputs have established, as a naive gateway would list them.
#[derive(Default)]
struct Facts {
    rules: Rules,
    peers: BTreeSet<GatewayId>,
    local: BTreeSet<Subject>,
    peer_offers: BTreeMap<(GatewayId, OfferId), (Subject, Vec<Hop>)>,
    /// The demand of the domain.
    taken: BTreeMap<(Subject, GatewayId), u16>,
    own_offers: BTreeMap<(GatewayId, OfferId), (Subject, Vec<Hop>)>,
    wanted_by: BTreeMap<(GatewayId, OfferId), u16>,
    proxies: BTreeMap<(Subject, GatewayId), GatewayId>,
    wants: BTreeSet<(GatewayId, OfferId)>,
    subscribed: BTreeMap<Subject, u16>,
}

impl Facts {
    fn allows(&self, subject: &Subject, direction: Direction, peer: &GatewayId) -> bool {
        self.rules
            .allow(subject.kind(), subject.name(), direction, peer)
    }

    fn input(&mut self, input: &Input) {
        match input.clone() {
            Input::Rules(rules) => self.rules = rules,
            Input::Up { peer } => {
                self.down(peer);
                self.peers.insert(peer);
            }
            Input::Down { peer } => self.down(peer),
            Input::Local { subject, present } => {
                match present {
                    true => self.local.insert(subject),
                    false => self.local.remove(&subject),
                };
            }
            Input::Taken {
                subject,
                origin,
                taken,
            } => {
                match taken {
                    Some(depth) => self.taken.insert((subject, origin), depth),
                    None => self.taken.remove(&(subject, origin)),
                };
            }
            Input::Offered {
                peer,
                offer,
                subject,
                path,
            } if self.peers.contains(&peer) => {
                self.peer_offers
                    .entry((peer, offer))
                    .or_insert((subject, path));
            }
            Input::Gone { peer, offer } => {
                self.peer_offers.remove(&(peer, offer));
                self.wants.remove(&(peer, offer));
            }
            Input::Wanted { peer, offer, depth }
                if self.own_offers.contains_key(&(peer, offer)) =>
            {
                self.wanted_by.insert((peer, offer), depth);
            }
            Input::Unwanted { peer, offer } => {
                self.wanted_by.remove(&(peer, offer));
            }
            Input::Offered { .. } | Input::Wanted { .. } | Input::Use { .. } | Input::Tick => {}
        }
    }

    fn down(&mut self, peer: GatewayId) {
        self.peers.remove(&peer);
        self.peer_offers.retain(|(of, _), _| *of != peer);
        self.wants.retain(|(of, _)| *of != peer);
        self.own_offers.retain(|(to, _), _| *to != peer);
        self.wanted_by.retain(|(to, _), _| *to != peer);
    }

    fn output(&mut self, output: Output) {
        match output {
            Output::Offer {
                peer,
                offer,
                subject,
                path,
            } => {
                assert_eq!(self.own_offers.insert((peer, offer), (subject, path)), None);
            }
            Output::Unoffer { peer, offer } => {
                assert!(self.own_offers.remove(&(peer, offer)).is_some());
                self.wanted_by.remove(&(peer, offer));
            }
            Output::Want { peer, offer, .. } => assert!(self.wants.insert((peer, offer))),
            Output::Unwant { peer, offer } => assert!(self.wants.remove(&(peer, offer))),
            Output::DeclareProxy {
                subject,
                origin,
                peer,
            } => {
                assert_eq!(self.proxies.insert((subject, origin), peer), None);
            }
            Output::WithdrawProxy { subject, origin } => {
                self.taken.remove(&(subject.clone(), origin));
                assert!(self.proxies.remove(&(subject, origin)).is_some());
            }
            Output::Subscribe { subject, depth } => {
                self.subscribed.insert(subject, depth);
            }
            Output::Unsubscribe { subject } => assert!(self.subscribed.remove(&subject).is_some()),
        }
    }

    /// The route of each origin of each subject, as SPEC states it.
    fn routes(&self) -> BTreeMap<(Subject, GatewayId), (GatewayId, OfferId, Vec<Hop>)> {
        let mut routes = BTreeMap::new();
        for ((peer, offer), (subject, path)) in &self.peer_offers {
            if !self.allows(subject, Direction::In, peer) {
                continue;
            }
            // All epochs and lengths are equal here, so the smallest peer and number win.
            let key = (subject.clone(), path[0].gateway);
            routes.entry(key).or_insert((*peer, *offer, path.clone()));
        }
        routes
    }

    /// Everything is updated: what is in effect follows from the facts.
    fn check(&self) {
        let routes = self.routes();
        let mut sources: Vec<(Subject, GatewayId, Vec<Hop>)> = Vec::new();
        sources.extend(
            self.local
                .iter()
                .map(|it| (it.clone(), id(0), vec![hop(0)])),
        );
        sources.extend(routes.iter().map(|((subject, origin), (.., path))| {
            let path = path.iter().copied().chain([hop(0)]).collect();
            (subject.clone(), *origin, path)
        }));
        let mut offers: Vec<_> = Vec::new();
        for (subject, _, path) in &sources {
            for peer in &self.peers {
                let is_back = path.iter().any(|it| it.gateway == *peer);
                if !is_back && self.allows(subject, Direction::Out, peer) {
                    offers.push((*peer, subject.clone(), path.clone()));
                }
            }
        }
        let own_offers = self.own_offers.iter();
        let mut made: Vec<_> = own_offers
            .map(|((to, _), (subject, path))| (*to, subject.clone(), path.clone()))
            .collect();
        offers.sort();
        made.sort();
        assert_eq!(made, offers, "the own offers");
        let shown: BTreeMap<_, _> = routes
            .iter()
            .map(|(key, (peer, ..))| (key.clone(), *peer))
            .collect();
        assert_eq!(self.proxies, shown, "the proxies");
        let demand = |subject: &Subject, origin: GatewayId| {
            let is_it = |(_, (of, path)): &(_, &(Subject, Vec<Hop>))| {
                of == subject && path[0].gateway == origin
            };
            let offers = self.own_offers.iter().filter(is_it);
            let wanted = offers.filter_map(|(key, _)| self.wanted_by.get(key));
            wanted
                .chain(self.taken.get(&(subject.clone(), origin)))
                .max()
                .copied()
        };
        let wants = routes
            .iter()
            .filter(|((subject, origin), _)| demand(subject, *origin).is_some());
        let wants: BTreeSet<_> = wants.map(|(_, (peer, offer, _))| (*peer, *offer)).collect();
        assert_eq!(self.wants, wants, "the wants");
        let subscribed = self
            .local
            .iter()
            .filter_map(|it| Some((it.clone(), demand(it, id(0))?)));
        assert_eq!(self.subscribed, subscribed.collect(), "the subscriptions");
    }
}

proptest! {
    #![proptest_config(cases(256))]

    /// However rules, connections, uses and pieces follow each other: after all pieces, exactly that is in effect
    /// which follows from the facts.
    //= SM2-GWO-004 test
    //= SM2-GWR-003 test
    //= SM2-GWR-004 test
    #[test]
    fn all_pieces_together_are_as_good_as_one(steps in steps(), crowd in any::<bool>()) {
        let mut bench = Bench(Router::new(hop(0), open()));
        let mut facts = Facts { rules: open(), ..Facts::default() };
        // So many sources that a walk has several pieces.
        let many = (0..if crowd { 400 } else { 0 }).map(|number| Input::Local {
            subject: topic(&format!("{}{number}", ["s", "u"][number % 2])),
            present: true,
        });
        let ups = [1, 2].map(|peer| Input::Up { peer: id(peer) });
        for input in ups.into_iter().chain(many).chain(steps.into_iter().map(input)) {
            facts.input(&input);
            for output in bench.input(input) {
                facts.output(output);
            }
        }
        for output in ticks(&mut bench).into_iter().flatten() {
            facts.output(output);
        }
        prop_assert_eq!(bench.0.deadline(), None::<Instant>);
        facts.check();
    }
}
