//! Routers: the outputs of one of them, and the routes of several in any arrangement.

// Shows GW-NOLOOP, GW-AUTH (proptest), bound: five gateways, links that come and go, rules between them; one gateway
// with 16,384 routes; changes of rules and ends of connections in pieces, against a naive list of facts.

mod ends;
mod pieces;
mod world;

use crate::support::contracts::{data, name};
use sm2_proto::gateway::{
    Action, Direction, GatewayId, Hop, OfferId, Pattern, Rule, Rules, Subject,
    router::{Input, Output, Router, Source},
};
use sm2_proto::{Instant, Machine, limits::HOPS_MAX};

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

/// The router of gateway 0.
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
        let Ok(()) = self.0.handle(Instant(0), input);
        std::iter::from_fn(|| self.0.poll()).collect()
    }

    fn local(&mut self, subject: &Subject, present: bool) -> Vec<Output> {
        let subject = subject.clone();
        self.input(Input::Local { subject, present })
    }

    fn offered(&mut self, offer: OfferId, way: &[usize]) -> Vec<Output> {
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

    fn wanted(&mut self, peer: usize, offer: OfferId, depth: Option<u16>) -> Vec<Output> {
        let peer = id(peer);
        self.input(match depth {
            Some(depth) => Input::Wanted { peer, offer, depth },
            None => Input::Unwanted { peer, offer },
        })
    }
}

fn offer(peer: usize, offer: OfferId, subject: &Subject, way: &[usize]) -> Output {
    Output::Offer {
        peer: id(peer),
        offer,
        subject: subject.clone(),
        path: path(way),
    }
}

fn unoffer(peer: usize, offer: OfferId) -> Output {
    let peer = id(peer);
    Output::Unoffer { peer, offer }
}

fn declare_proxy(origin: usize, peer: usize) -> Output {
    Output::DeclareProxy {
        subject: topic("a"),
        origin: id(origin),
        peer: id(peer),
    }
}

fn withdraw_proxy(origin: usize) -> Output {
    Output::WithdrawProxy {
        subject: topic("a"),
        origin: id(origin),
    }
}

fn want(peer: usize, offer: OfferId, depth: u16) -> Output {
    let peer = id(peer);
    Output::Want { peer, offer, depth }
}

fn unwant(peer: usize, offer: OfferId) -> Output {
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
    let expected = [
        offer(1, OfferId(1), &subject, &[0]),
        offer(2, OfferId(1), &subject, &[0]),
    ];
    assert_eq!(bench.local(&subject, true), expected);
    assert_eq!(bench.local(&subject, true), []);
    assert_eq!(bench.wanted(1, OfferId(1), Some(3)), [subscribe(3)]);
    assert_eq!(bench.wanted(2, OfferId(1), Some(2)), []);
    let takers: Vec<_> = bench.0.takers(&subject, Source::Local).collect();
    assert_eq!(takers, [(id(1), OfferId(1)), (id(2), OfferId(1))]);
    assert_eq!(
        bench.0.source(id(2), OfferId(1)),
        Some((&subject, Source::Local))
    );
    assert_eq!(bench.0.source(id(2), OfferId(2)), None);
    assert_eq!(bench.wanted(1, OfferId(1), None), [subscribe(2)]);
    let unsubscribe = Output::Unsubscribe {
        subject: subject.clone(),
    };
    assert_eq!(
        bench.wanted(2, OfferId(1), None),
        std::slice::from_ref(&unsubscribe)
    );
    bench.wanted(2, OfferId(1), Some(1));
    assert_eq!(bench.wanted(2, OfferId(9), Some(1)), [], "no such offer");
    assert_eq!(
        bench.local(&subject, false),
        [unoffer(1, OfferId(1)), unoffer(2, OfferId(1)), unsubscribe]
    );
    assert_eq!(bench.wanted(2, OfferId(1), Some(1)), [], "it is withdrawn");
    let expected = [
        offer(1, OfferId(2), &subject, &[0]),
        offer(2, OfferId(2), &subject, &[0]),
    ];
    assert_eq!(bench.local(&subject, true), expected, "under a new number");
    // A peer that connects later gets the offer as well.
    let up = bench.input(Input::Up { peer: id(3) });
    assert_eq!(up, [offer(3, OfferId(1), &subject, &[0])]);
}

//= SM2-GWO-004 test
#[test]
fn one_offer_of_each_origin_is_used() {
    let mut bench = Bench::new(open(), &[1, 2, 3]);
    let passed_on = |to: usize, number, way: &[usize]| offer(to, number, &topic("a"), way);
    let shown = bench.offered(OfferId(1), &[5, 6, 2]);
    let expected = [
        passed_on(1, OfferId(1), &[5, 6, 2, 0]),
        passed_on(3, OfferId(1), &[5, 6, 2, 0]),
        declare_proxy(5, 2),
    ];
    assert_eq!(shown, expected);
    assert_eq!(bench.taken(5, Some(4)), [want(2, OfferId(1), 4)]);
    // A longer path, and a path of the same length from a greater id, change nothing.
    assert_eq!(bench.offered(OfferId(1), &[5, 6, 7, 1]), []);
    assert_eq!(bench.offered(OfferId(1), &[5, 6, 3]), []);
    // A path of the same length from a smaller id is used. Its offer is wanted when somebody takes the
    // publisher that is shown now.
    let expected = [
        unoffer(1, OfferId(1)),
        unoffer(3, OfferId(1)),
        passed_on(2, OfferId(1), &[5, 6, 1, 0]),
        passed_on(3, OfferId(2), &[5, 6, 1, 0]),
        withdraw_proxy(5),
        unwant(2, OfferId(1)),
        declare_proxy(5, 1),
    ];
    assert_eq!(bench.offered(OfferId(2), &[5, 6, 1]), expected);
    assert_eq!(bench.taken(5, Some(1)), [want(1, OfferId(2), 1)]);
    // A newer process of the origin wins, although its path is longer.
    let newer = Hop { epoch: 8, ..hop(5) };
    let outputs = bench.input(Input::Offered {
        peer: id(3),
        offer: OfferId(2),
        subject: topic("a"),
        path: vec![newer, hop(6), hop(7), hop(3)],
    });
    assert!(outputs.contains(&declare_proxy(5, 3)), "{outputs:?}");
    // When that offer ends, the route before it is used again.
    let outputs = bench.input(Input::Gone {
        peer: id(3),
        offer: OfferId(2),
    });
    assert!(outputs.contains(&declare_proxy(5, 1)), "{outputs:?}");
    // The number of an existing offer cannot be used for another.
    assert_eq!(bench.offered(OfferId(2), &[5, 1]), []);
    assert_eq!(
        bench.input(Input::Offered {
            peer: id(1),
            offer: OfferId(2),
            subject: topic("b"),
            path: path(&[1]),
        }),
        []
    );
    // Another origin has its own route.
    let outputs = bench.offered(OfferId(9), &[8, 2]);
    assert!(outputs.contains(&declare_proxy(8, 2)) && !outputs.contains(&withdraw_proxy(5)));
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
    assert_eq!(
        bench.local(&subject, true),
        [offer(1, OfferId(1), &subject, &[0])]
    );
    assert_eq!(bench.offered(OfferId(1), &[1]), [], "not from there");
    let expected = [offer(1, OfferId(2), &subject, &[2, 0]), declare_proxy(2, 2)];
    assert_eq!(bench.offered(OfferId(1), &[2]), expected);
    bench.wanted(1, OfferId(1), Some(1));
    assert_eq!(
        bench.wanted(1, OfferId(2), Some(1)),
        [want(2, OfferId(1), 1)]
    );
    // New rules end at once what they do not allow.
    let outputs = bench.input(Input::Rules(Rules(vec![only(Direction::In, 1)])));
    let unsubscribe = Output::Unsubscribe {
        subject: subject.clone(),
    };
    let expected = [
        unoffer(1, OfferId(1)),
        unsubscribe,
        declare_proxy(1, 1),
        unoffer(1, OfferId(2)),
        withdraw_proxy(2),
        unwant(2, OfferId(1)),
    ];
    assert_eq!(outputs, expected);
}

//= SM2-GWO-003 test
#[test]
fn a_way_has_its_length() {
    let mut bench = Bench::new(open(), &[1, 2]);
    let way: Vec<usize> = (3..3 + HOPS_MAX - 1).chain([1]).collect();
    assert_eq!(way.len(), HOPS_MAX);
    let shown = [declare_proxy(3, 1)];
    assert_eq!(
        bench.offered(OfferId(1), &way),
        shown,
        "shown, and not passed on"
    );
    let outputs = bench.offered(OfferId(2), &way[1..]);
    assert_eq!(outputs.len(), 2, "passed on and shown: {outputs:?}");
}

#[test]
fn a_peer_that_is_gone_leaves_nothing() {
    let mut bench = Bench::new(open(), &[1, 2]);
    let before = bench.0.clone();
    bench.offered(OfferId(1), &[3, 1]);
    bench.taken(3, Some(1));
    bench.wanted(2, OfferId(1), Some(1));
    let outputs = bench.input(Input::Down { peer: id(1) });
    assert_eq!(outputs, [unoffer(2, OfferId(1)), withdraw_proxy(3)]);
    assert_eq!(
        bench.offered(OfferId(1), &[3, 1]),
        [],
        "it has no connection"
    );
    for input in [
        Input::Gone {
            peer: id(1),
            offer: OfferId(1),
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
