//! Discovery: which peers a gateway dials, where and when, and its own beacons.

// Shows GW-FIND (proptest), bound: cases; sampled events of three peers.

use std::{collections::BTreeMap, net::SocketAddr};

use crate::support::cases;
use proptest::{collection::vec, prelude::*};
use sm2_proto::{
    Instant, Machine,
    gateway::{
        Beacon, GatewayId,
        discovery::{Discovery, Input, Output},
    },
    limits::BEACONS_PER_S,
};

const ME: GatewayId = GatewayId([0; 32]);
const PEER: GatewayId = GatewayId([1; 32]);
const OTHER: GatewayId = GatewayId([2; 32]);
const MS: u64 = 1_000_000;
const S: u64 = 1_000 * MS;

fn address(last: u16) -> SocketAddr {
    SocketAddr::from(([0xfe80, 0, 0, 0, 0, 0, 0, last], 7_000 + last))
}

struct Bench {
    discovery: Discovery,
    now: Instant,
}

impl Bench {
    fn new() -> Self {
        let now = Instant(5);
        Self {
            discovery: Discovery::new(now, ME, 7, false),
            now,
        }
    }

    fn input(&mut self, input: Input<'_>) -> Vec<Output> {
        let Ok(()) = self.discovery.handle(self.now, input);
        std::iter::from_fn(|| self.discovery.poll()).collect()
    }

    fn trust(&mut self, peer: GatewayId, addresses: &[u16]) -> Vec<Output> {
        self.trust_with_hosts(peer, addresses, 0)
    }

    fn trust_with_hosts(
        &mut self,
        peer: GatewayId,
        addresses: &[u16],
        hosts: usize,
    ) -> Vec<Output> {
        let addresses = addresses.iter().map(|it| address(*it)).collect();
        self.input(Input::Trust {
            peer,
            addresses,
            hosts,
        })
    }

    /// Feeds a beacon of `gateway` with this epoch, sent from address `last`.
    fn beacon(&mut self, gateway: GatewayId, last: u16, epoch: u64) -> Vec<Output> {
        let bytes = Beacon {
            port: 7_000 + last,
            gateway,
            epoch,
        }
        .to_bytes();
        let mut from = address(last);
        from.set_port(1);
        let bytes = &bytes;
        self.input(Input::Beacon { from, bytes })
    }

    fn connected(&mut self, epoch: u64) -> Vec<Output> {
        self.input(Input::Connected { peer: PEER, epoch })
    }

    /// Advances time to the deadline. Returns the time that passed, in nanoseconds, and the outputs.
    fn next(&mut self) -> (u64, Vec<Output>) {
        let until = self.discovery.deadline().expect("something is due");
        let before = std::mem::replace(&mut self.now, until);
        (until.0 - before.0, self.input(Input::Tick))
    }
}

fn dial(peer: GatewayId, last: u16) -> Vec<Output> {
    let address = address(last);
    vec![Output::Dial { peer, address }]
}

//= SM2-GWC-005 test
#[test]
fn a_stale_attempt_is_repeated_soon() {
    let mut bench = Bench::new();
    bench.trust(PEER, &[1]);
    for _ in 0..20 {
        bench.next();
        bench.input(Input::Failed { peer: PEER });
    }
    for ends in [Input::Failed { peer: PEER }, Input::Lost { peer: PEER }] {
        assert_eq!(bench.next().1, dial(PEER, 1));
        if ends == (Input::Lost { peer: PEER }) {
            bench.connected(7);
        }
        bench.input(Input::Stale { peer: PEER });
        bench.input(ends);
        assert!(bench.discovery.deadline() <= Some(Instant(bench.now.0 + S)));
    }
    // Another failure waits as before.
    bench.next();
    bench.input(Input::Failed { peer: PEER });
    assert!(bench.discovery.deadline() > Some(Instant(bench.now.0 + 2 * S)));
}

//= SM2-GWD-004 test
#[test]
fn addresses_in_turn_with_longer_and_longer_waits() {
    let mut bench = Bench::new();
    assert_eq!(bench.trust(PEER, &[1, 2]), []);
    let mut most = 10 * MS;
    for turn in 0..20 {
        let (waited, outputs) = bench.next();
        assert!(waited <= most, "{turn}: {waited}");
        assert!(turn == 0 || waited >= most / 2, "{turn}: {waited}");
        assert_eq!(outputs, dial(PEER, 1 + turn % 2));
        assert_eq!(bench.discovery.deadline(), None, "one attempt at a time");
        assert_eq!(bench.input(Input::Failed { peer: PEER }), []);
        most = (2 * most).min(5 * S);
    }
    // The two newest addresses of beacons come after those of the configuration.
    for last in [3, 4, 5, 5] {
        assert_eq!(bench.beacon(PEER, last, 1), []);
    }
    for last in [5, 4, 1, 2, 5] {
        assert_eq!(bench.next().1, dial(PEER, last));
        bench.input(Input::Failed { peer: PEER });
    }
}

#[test]
fn hosts_have_their_turns_after_addresses() {
    let mut bench = Bench::new();
    bench.trust(PEER, &[]);
    assert_eq!(bench.discovery.deadline(), None, "nowhere to look");
    bench.trust_with_hosts(PEER, &[], 2);
    let host = |host| vec![Output::DialHost { peer: PEER, host }];
    for turn in 0..4 {
        assert_eq!(bench.next().1, host(turn % 2));
        bench.input(Input::Failed { peer: PEER });
    }
    bench.trust_with_hosts(PEER, &[1], 2);
    bench.beacon(PEER, 3, 1);
    // The next ones in the order that the locations have now.
    for outputs in [host(1), dial(PEER, 3), dial(PEER, 1), host(0), host(1)] {
        let (_, found) = bench.next();
        bench.input(Input::Failed { peer: PEER });
        assert_eq!(found, outputs);
    }
    // A peer with host names alone, and then with no location.
    let mut bench = Bench::new();
    bench.trust_with_hosts(PEER, &[], 1);
    assert!(bench.discovery.deadline().is_some());
    bench.trust_with_hosts(PEER, &[], 0);
    assert_eq!(bench.discovery.deadline(), None);
}

//= SM2-GWD-004 test
#[test]
fn a_connection_ends_the_search_and_its_end_begins_it() {
    let mut bench = Bench::new();
    bench.trust(PEER, &[1]);
    for _ in 0..12 {
        bench.next();
        bench.input(Input::Failed { peer: PEER });
    }
    assert_eq!(bench.connected(4), []);
    assert_eq!(bench.discovery.deadline(), None);
    // A connection that ends before the longest wait counts as a failed attempt.
    bench.now = Instant(bench.now.0 + 5 * S - 1);
    bench.input(Input::Lost { peer: PEER });
    assert!(bench.next().0 >= 2_500 * MS);
    bench.connected(4);
    bench.now = Instant(bench.now.0 + 5 * S);
    bench.input(Input::Lost { peer: PEER });
    assert!(bench.next().0 <= 10 * MS);
    // An attempt fails after the peer has opened a connection.
    bench.connected(4);
    assert_eq!(bench.input(Input::Failed { peer: PEER }), []);
    assert_eq!(bench.discovery.deadline(), None);
}

//= SM2-GWD-002, SM2-GWD-004 test
#[test]
fn a_beacon_is_a_hint() {
    let mut bench = Bench::new();
    assert_eq!(bench.beacon(PEER, 3, 1), []);
    assert_eq!(bench.discovery.deadline(), None, "not trusted");
    bench.trust(PEER, &[]);
    bench.trust(ME, &[]);
    assert_eq!(bench.discovery.deadline(), None, "nowhere to look");
    bench.beacon(OTHER, 3, 1);
    bench.beacon(ME, 3, 1);
    assert_eq!(bench.discovery.deadline(), None, "others, and itself");
    bench.beacon(PEER, 3, 1);
    assert_eq!(bench.next().1, dial(PEER, 3));
    // While there is a connection, only a beacon of a newer process has an effect, and only one.
    bench.connected(6);
    bench.beacon(PEER, 4, 6);
    bench.beacon(PEER, 4, 5);
    assert_eq!(bench.discovery.deadline(), None);
    bench.beacon(PEER, 4, 7);
    let until = bench.discovery.deadline();
    bench.beacon(PEER, 4, 8);
    assert_eq!(bench.discovery.deadline(), until);
    let dialed = bench.next().1;
    assert!(
        dialed == dial(PEER, 3) || dialed == dial(PEER, 4),
        "{dialed:?}"
    );
    bench.beacon(PEER, 4, 8);
    assert_eq!(bench.discovery.deadline(), None, "it is being tried");
    bench.input(Input::Failed { peer: PEER });
    assert_eq!(
        bench.discovery.deadline(),
        None,
        "the connection is there still"
    );
    bench.beacon(PEER, 4, 8);
    assert!(bench.discovery.deadline().is_some());
    // The connection is lost while another attempt is in flight: the attempt goes on.
    bench.next();
    bench.input(Input::Lost { peer: PEER });
    assert_eq!(bench.discovery.deadline(), None);
    bench.connected(8);
    bench.beacon(PEER, 4, 8);
    assert_eq!(bench.discovery.deadline(), None);
}

//= SM2-GWD-001 test
#[test]
fn what_is_no_beacon_is_ignored() {
    let mut bench = Bench::new();
    bench.trust(PEER, &[]);
    let before = bench.discovery.clone();
    let from = address(3);
    for bytes in [&b""[..], b"SM2G", &[0; 56]] {
        assert_eq!(bench.input(Input::Beacon { from, bytes }), []);
    }
    assert_eq!(bench.discovery.deadline(), before.deadline());
}

//= SM2-GWD-003 test
#[test]
fn a_flood_of_beacons() {
    let mut bench = Bench::new();
    bench.trust(PEER, &[]);
    bench.now = Instant(bench.now.0 + S - 1);
    for _ in 0..BEACONS_PER_S - 1 {
        bench.beacon(OTHER, 3, 1);
    }
    let mut one_less = Bench {
        discovery: bench.discovery.clone(),
        now: bench.now,
    };
    one_less.beacon(PEER, 3, 1);
    assert!(one_less.discovery.deadline().is_some());
    bench.beacon(OTHER, 3, 1);
    bench.beacon(PEER, 3, 1);
    assert_eq!(bench.discovery.deadline(), None, "too many in this second");
    bench.now = Instant(bench.now.0 + 1);
    bench.beacon(PEER, 3, 1);
    assert!(bench.discovery.deadline().is_some());
}

#[test]
fn other_configurations() {
    let mut bench = Bench::new();
    bench.trust(PEER, &[1]);
    bench.trust(PEER, &[]);
    assert_eq!(bench.discovery.deadline(), None, "nowhere to look any more");
    bench.trust(PEER, &[2]);
    let until = bench.discovery.deadline();
    bench.trust(PEER, &[3]);
    assert_eq!(bench.discovery.deadline(), until, "it waits already");
    assert_eq!(bench.next().1, dial(PEER, 3));
    bench.trust(PEER, &[]);
    bench.input(Input::Failed { peer: PEER });
    assert_eq!(bench.discovery.deadline(), None);
    bench.trust(PEER, &[3]);
    bench.input(Input::Distrust { peer: PEER });
    assert_eq!(bench.discovery.deadline(), None);
    for input in [
        Input::Lost { peer: PEER },
        Input::Failed { peer: PEER },
        Input::Connected {
            peer: PEER,
            epoch: 1,
        },
        Input::Distrust { peer: PEER },
    ] {
        assert_eq!(bench.input(input), []);
    }
    bench.beacon(PEER, 3, 1);
    assert_eq!(bench.discovery.deadline(), None);
}

//= SM2-GWD-005 test
#[test]
fn beacons_of_its_own() {
    let mut discovery = Discovery::new(Instant(9), ME, 1, true);
    let mut waits = vec![];
    for _ in 0..200 {
        let at = discovery.deadline().unwrap();
        let Ok(()) = discovery.handle(at, Input::Tick);
        assert_eq!(discovery.poll(), Some(Output::Announce));
        assert_eq!(discovery.poll(), None);
        waits.push(discovery.deadline().unwrap().0 - at.0);
    }
    assert!(waits.iter().all(|it| (S / 2..=S).contains(it)));
    assert!(waits.iter().any(|it| *it < 600 * MS) && waits.iter().any(|it| *it > 900 * MS));
}

/// An operation of the random test; the first field is the index of a peer.
#[derive(Clone, Copy, Debug)]
enum Op {
    Trust(usize, u16),
    Distrust(usize),
    Beacon(usize, u16, u64),
    Connected(usize, u64),
    Lost(usize),
    Failed(usize),
    Wait(u64),
}

fn op() -> impl Strategy<Value = Op> {
    let peer = 0_usize..3;
    prop_oneof![
        (peer.clone(), 0_u16..3).prop_map(|(peer, count)| Op::Trust(peer, count)),
        peer.clone().prop_map(Op::Distrust),
        (peer.clone(), 3_u16..6, 0_u64..5)
            .prop_map(|(peer, at, epoch)| Op::Beacon(peer, at, epoch)),
        (peer.clone(), 0_u64..5).prop_map(|(peer, epoch)| Op::Connected(peer, epoch)),
        peer.clone().prop_map(Op::Lost),
        peer.prop_map(Op::Failed),
        (0_u64..3_000).prop_map(Op::Wait),
    ]
}

proptest! {
    #![proptest_config(cases(400))]

    /// In any order of events, discovery dials only trusted peers, one attempt at a time for each, at
    /// addresses of the configuration or of beacons. It dials each peer with an address and without a
    /// connection within 5 s.
    //= SM2-GWD-002, SM2-GWD-003, SM2-GWD-004 test
    #[test]
    fn nobody_is_forgotten_and_nobody_pestered(ops in vec(op(), 0..120)) {
        let peers = [PEER, OTHER, ME];
        let mut bench = Bench::new();
        let mut dialing: BTreeMap<GatewayId, bool> = BTreeMap::new();
        let mut connected: BTreeMap<GatewayId, bool> = BTreeMap::new();
        let mut named: BTreeMap<GatewayId, Vec<SocketAddr>> = BTreeMap::new();
        for op in ops {
            let outputs = match op {
                Op::Trust(peer, count) => {
                    let addresses: Vec<u16> = (0..count).collect();
                    let all = named.entry(peers[peer]).or_default();
                    all.retain(|it| it.port() >= 7_003);
                    all.extend(addresses.iter().map(|it| address(*it)));
                    dialing.entry(peers[peer]).or_default();
                    connected.entry(peers[peer]).or_default();
                    bench.trust(peers[peer], &addresses)
                }
                Op::Distrust(peer) => {
                    named.remove(&peers[peer]);
                    dialing.remove(&peers[peer]);
                    connected.remove(&peers[peer]);
                    bench.input(Input::Distrust { peer: peers[peer] })
                }
                Op::Beacon(peer, at, epoch) => {
                    if peers[peer] != ME && let Some(all) = named.get_mut(&peers[peer]) {
                        all.push(address(at));
                    }
                    bench.beacon(peers[peer], at, epoch)
                }
                Op::Connected(peer, epoch) => {
                    let peer = peers[peer];
                    dialing.entry(peer).and_modify(|it| *it = false);
                    connected.entry(peer).and_modify(|it| *it = true);
                    bench.input(Input::Connected { peer, epoch })
                }
                Op::Lost(peer) => {
                    connected.entry(peers[peer]).and_modify(|it| *it = false);
                    bench.input(Input::Lost { peer: peers[peer] })
                }
                Op::Failed(peer) => {
                    dialing.entry(peers[peer]).and_modify(|it| *it = false);
                    bench.input(Input::Failed { peer: peers[peer] })
                }
                Op::Wait(ms) => {
                    bench.now = Instant(bench.now.0 + ms * MS);
                    bench.input(Input::Tick)
                }
            };
            for output in outputs {
                let Output::Dial { peer, address } = output else {
                    panic!("{output:?}");
                };
                prop_assert!(named[&peer].contains(&address), "{peer} at {address}");
                prop_assert_eq!(dialing.insert(peer, true), Some(false), "{}", peer);
            }
            let deadline = bench.discovery.deadline();
            let waits = |peer: &GatewayId| !named[peer].is_empty() && !dialing[peer] && !connected[peer];
            if named.keys().any(waits) {
                let soon = Instant(bench.now.0 + 5 * S);
                prop_assert!(deadline.is_some_and(|it| bench.now < it && it <= soon), "{deadline:?}");
            }
        }
    }
}
