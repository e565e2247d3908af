//! Decides which peers a gateway dials, where and when: SPEC section 14.7.
//!
//! Beacons are hints that anybody can send. A beacon makes a gateway try an address of a peer that
//! it trusts, at a bounded rate, and has no other effect. [`Discovery`] keeps the contract of
//! [`Machine`]; it never ends, and no input is a misuse.

use alloc::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    vec::Vec,
};
use core::{convert::Infallible, net::SocketAddr, time::Duration};

use super::{Beacon, GatewayId};
use crate::{
    Backoff, Instant, Machine, MisuseError, limits::BEACONS_PER_S, machine::debug_assert_drained,
};

/// The longest wait before an attempt to connect.
const WAIT_MAX: Duration = Duration::from_secs(5);
/// The longest wait after a peer has closed a connection as `stale`.
const STALE_WAIT_MAX: Duration = Duration::from_secs(1);
/// The longest time between two own beacons, and the length of a [`BeaconWindow`].
const BEACON_PERIOD: Duration = Duration::from_secs(1);

/// An input of discovery. Inputs about a peer that is not trusted are ignored. [`Input::Failed`]
/// may come while outputs wait: the attempt that [`Output::Dial`] asked for could not begin.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input<'a> {
    /// The configuration trusts a peer. A second input for the same peer replaces the first.
    Trust {
        /// The id of the peer.
        peer: GatewayId,
        /// The addresses of the peer in the configuration.
        addresses: Vec<SocketAddr>,
        /// How many host names the configuration has for the peer. The driver looks them up.
        hosts: usize,
    },
    /// The configuration no longer trusts a peer.
    Distrust {
        /// The id of the peer.
        peer: GatewayId,
    },
    /// A datagram was received from the multicast group.
    Beacon {
        /// The source address of the datagram.
        from: SocketAddr,
        /// The datagram.
        bytes: &'a [u8],
    },
    /// A connection with a peer is open. Either side may have opened it.
    Connected {
        /// The id of the peer.
        peer: GatewayId,
        /// The epoch in the peer's HELLO.
        epoch: u64,
    },
    /// The connection with a peer has ended.
    Lost {
        /// The id of the peer.
        peer: GatewayId,
    },
    /// The attempt to connect to a peer failed.
    Failed {
        /// The id of the peer.
        peer: GatewayId,
    },
    /// A peer has closed a connection as `stale`: it still has one with an earlier process of this
    /// gateway. [`Input::Failed`] or [`Input::Lost`] follows.
    Stale {
        /// The id of the peer.
        peer: GatewayId,
    },
    /// The deadline has come.
    Tick,
}

/// Work for the driver of discovery.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Try to connect to a peer; report [`Input::Connected`] or [`Input::Failed`].
    Dial {
        /// The id of the peer.
        peer: GatewayId,
        /// The address to try.
        address: SocketAddr,
    },
    /// Look up a host name of a peer and try to connect; report as for [`Output::Dial`].
    DialHost {
        /// The id of the peer.
        peer: GatewayId,
        /// The index of the host name in the configuration, from 0.
        host: usize,
    },
    /// Send a beacon on each interface.
    Announce,
}

/// The machine that finds peers and decides when to dial them.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Discovery {
    me: GatewayId,
    peers: BTreeMap<GatewayId, Peer>,
    /// The timers of all peers that wait for an attempt.
    timers: BTreeSet<(Instant, GatewayId)>,
    /// The time of the next beacon, if this gateway sends beacons.
    announce_at: Option<Instant>,
    beacon_window: BeaconWindow,
    /// The source of randomness for the times of beacons and for the backoff of each peer.
    random: Backoff,
    outputs: VecDeque<Output>,
}

/// Limits how many datagrams are examined per second (SM2-GWD-003).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct BeaconWindow {
    begin: Instant,
    examined: u32,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Peer {
    /// The addresses of the configuration.
    configured: Vec<SocketAddr>,
    /// The number of host names of the configuration.
    hosts: usize,
    /// The addresses that beacons named, the newest first.
    announced: [Option<SocketAddr>; 2],
    backoff: Backoff,
    /// True if the peer has closed the last connection as `stale`.
    is_stale: bool,
    /// The index of the next location to try.
    next: usize,
    state: State,
}

/// A location where a peer may be found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Location {
    Address(SocketAddr),
    Host(usize),
}

/// The states of SPEC, Annex B.14.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum State {
    /// No location is known.
    Unknown,
    /// The next attempt begins at `until`.
    Waiting { until: Instant },
    /// An attempt is in flight.
    Dialing,
    /// A connection is open.
    Connected {
        since: Instant,
        epoch: u64,
        redial: Redial,
    },
}

/// Attempts beside an open connection, after a beacon has named a newer process of the peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Redial {
    /// No beacon has named a newer process.
    None,
    /// The attempt begins at `until`.
    Waiting { until: Instant },
    /// The attempt is in flight.
    Dialing,
}

impl Discovery {
    /// Discovery without peers, for the gateway `me`. `seed` differs between processes. If `announces`
    /// is true, the gateway sends beacons.
    #[must_use]
    pub fn new(now: Instant, me: GatewayId, seed: u64, announces: bool) -> Self {
        Self {
            me,
            peers: BTreeMap::new(),
            timers: BTreeSet::new(),
            announce_at: announces.then_some(now),
            beacon_window: BeaconWindow {
                begin: now,
                examined: 0,
            },
            random: Backoff::new(seed, WAIT_MAX),
            outputs: VecDeque::new(),
        }
    }

    fn input(&mut self, now: Instant, input: Input<'_>) {
        match input {
            Input::Trust {
                peer,
                addresses,
                hosts,
            } => self.trust(now, peer, addresses, hosts),
            Input::Distrust { peer } => self.distrust(peer),
            Input::Beacon { from, bytes } => self.beacon(now, from, bytes),
            Input::Connected { peer, epoch } => {
                let state = State::Connected {
                    since: now,
                    epoch,
                    redial: Redial::None,
                };
                self.enter(peer, state);
            }
            Input::Lost { peer } => self.lost(now, peer),
            Input::Failed { peer } => self.failed(now, peer),
            Input::Stale { peer } => {
                if let Some(it) = self.peers.get_mut(&peer) {
                    it.is_stale = true;
                }
            }
            Input::Tick => {}
        }
    }

    fn trust(&mut self, now: Instant, peer: GatewayId, addresses: Vec<SocketAddr>, hosts: usize) {
        let seed = self.random.random();
        let it = self.peers.entry(peer).or_insert_with(|| Peer {
            configured: Vec::new(),
            hosts: 0,
            announced: [None; 2],
            backoff: Backoff::new(seed, WAIT_MAX),
            is_stale: false,
            next: 0,
            state: State::Unknown,
        });
        (it.configured, it.hosts) = (addresses, hosts);
        match it.state {
            State::Waiting { .. } if it.locations().next().is_none() => {
                self.enter(peer, State::Unknown);
            }
            State::Unknown => self.wait(now, peer),
            State::Waiting { .. } | State::Dialing | State::Connected { .. } => {}
        }
    }

    fn distrust(&mut self, peer: GatewayId) {
        self.enter(peer, State::Unknown);
        self.peers.remove(&peer);
    }

    //= SM2-GWD-001, SM2-GWD-002, SM2-GWD-003, SM2-GWD-004
    fn beacon(&mut self, now: Instant, from: SocketAddr, bytes: &[u8]) {
        if !self.beacon_window.admits(now) {
            return;
        }
        let Ok(beacon) = Beacon::from_bytes(bytes) else {
            return;
        };
        let gateway = beacon.gateway;
        let Some(peer) = self.peers.get_mut(&gateway).filter(|_| gateway != self.me) else {
            return;
        };
        let mut address = from;
        address.set_port(beacon.port);
        peer.remember(address);
        match peer.state {
            State::Unknown => self.wait(now, gateway),
            State::Connected {
                since,
                epoch,
                redial: Redial::None,
            } if beacon.epoch > epoch => {
                let until = now.after(peer.backoff.wait());
                let redial = Redial::Waiting { until };
                let state = State::Connected {
                    since,
                    epoch,
                    redial,
                };
                self.enter(gateway, state);
            }
            State::Waiting { .. } | State::Dialing | State::Connected { .. } => {}
        }
    }

    fn lost(&mut self, now: Instant, peer: GatewayId) {
        let Some(it) = self.peers.get_mut(&peer) else {
            return;
        };
        if let State::Connected { since, redial, .. } = it.state {
            it.backoff.ended_after(now.since(since));
            match redial {
                // The attempt that is in flight goes on.
                Redial::Dialing => self.enter(peer, State::Dialing),
                Redial::None | Redial::Waiting { .. } => self.wait(now, peer),
            }
        }
    }

    fn failed(&mut self, now: Instant, peer: GatewayId) {
        match self.peers.get(&peer).map(|it| it.state) {
            Some(State::Dialing) => self.wait(now, peer),
            Some(State::Connected {
                since,
                epoch,
                redial: Redial::Dialing,
            }) => {
                let state = State::Connected {
                    since,
                    epoch,
                    redial: Redial::None,
                };
                self.enter(peer, state);
            }
            _ => {}
        }
    }

    /// Schedules the next attempt to connect to a peer, if a location is known.
    fn wait(&mut self, now: Instant, peer: GatewayId) {
        let Some(it) = self.peers.get_mut(&peer) else {
            return;
        };
        let has_location = it.locations().next().is_some();
        let state = if has_location {
            //= SM2-GWC-005
            let most = match core::mem::take(&mut it.is_stale) {
                true => STALE_WAIT_MAX,
                false => WAIT_MAX,
            };
            let until = now.after(it.backoff.wait().min(most));
            State::Waiting { until }
        } else {
            State::Unknown
        };
        self.enter(peer, state);
    }

    /// The one place where the state of a peer changes, and its timer with it.
    fn enter(&mut self, peer: GatewayId, state: State) {
        let Some(it) = self.peers.get_mut(&peer) else {
            return;
        };
        if let Some(at) = it.state.until() {
            self.timers.remove(&(at, peer));
        }
        it.state = state;
        if let Some(at) = state.until() {
            self.timers.insert((at, peer));
        }
    }

    /// Runs all timers that have expired.
    fn run_timers(&mut self, now: Instant) {
        while let Some(&(_, peer)) = self.timers.first().filter(|(at, _)| *at <= now) {
            let Some(it) = self.peers.get_mut(&peer) else {
                return;
            };
            let location = it.next_location();
            let state = match it.state {
                State::Connected { since, epoch, .. } => State::Connected {
                    since,
                    epoch,
                    redial: location.map_or(Redial::None, |_| Redial::Dialing),
                },
                _ if location.is_some() => State::Dialing,
                _ => State::Unknown,
            };
            self.enter(peer, state);
            let dial = location.map(|location| match location {
                Location::Address(address) => Output::Dial { peer, address },
                Location::Host(host) => Output::DialHost { peer, host },
            });
            self.outputs.extend(dial);
        }
        //= SM2-GWD-005
        if self.announce_at.is_some_and(|at| at <= now) {
            self.outputs.push_back(Output::Announce);
            let less = self.random.random_up_to(BEACON_PERIOD / 2);
            self.announce_at = Some(now.after(BEACON_PERIOD - less));
        }
    }

    /// The timers are exactly those of the states.
    fn invariants(&self) {
        let timer = |(id, it): (&GatewayId, &Peer)| it.state.until().map(|at| (at, *id));
        let timers = || self.peers.iter().filter_map(timer);
        debug_assert_eq!(timers().count(), self.timers.len());
        debug_assert!(timers().all(|it| self.timers.contains(&it)));
    }
}

impl Machine for Discovery {
    type Input<'a> = Input<'a>;
    type Output = Output;
    type End = Infallible;
    type Misuse = Infallible;

    /// Feeds one input. It is always legal.
    fn handle(&mut self, now: Instant, input: Input<'_>) -> Result<(), MisuseError<Infallible>> {
        if !matches!(input, Input::Failed { .. }) {
            debug_assert_drained(&self.outputs);
        }
        self.input(now, input);
        self.run_timers(now);
        self.invariants();
        Ok(())
    }

    fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    fn deadline(&self) -> Option<Instant> {
        let timer = self.timers.first().map(|(at, _)| *at);
        timer.into_iter().chain(self.announce_at).min()
    }
}

impl Peer {
    /// The locations in the order in which they are tried: those of the configuration first.
    fn locations(&self) -> impl Iterator<Item = Location> {
        let configured = self.configured.iter().copied().map(Location::Address);
        let hosts = (0..self.hosts).map(Location::Host);
        let announced = self.announced.iter().flatten().copied();
        let announced = announced.map(Location::Address);
        configured.chain(hosts).chain(announced)
    }

    /// The next location; after the last one, the first again.
    fn next_location(&mut self) -> Option<Location> {
        let location = self.locations().nth(self.next);
        let location = location.or_else(|| {
            self.next = 0;
            self.locations().next()
        });
        self.next += 1;
        location
    }

    /// Remembers an address that a beacon named.
    fn remember(&mut self, address: SocketAddr) {
        let [newest, before] = &mut self.announced;
        if *newest != Some(address) {
            *before = newest.replace(address);
        }
    }
}

impl BeaconWindow {
    /// Whether one more datagram may be examined; counts it.
    fn admits(&mut self, now: Instant) -> bool {
        if now.since(self.begin) >= BEACON_PERIOD {
            *self = Self {
                begin: now,
                examined: 0,
            };
        }
        let admits = self.examined < BEACONS_PER_S;
        if admits {
            self.examined += 1;
        }
        admits
    }
}

impl State {
    /// The time of the timer, if the state has one.
    const fn until(self) -> Option<Instant> {
        match self {
            Self::Waiting { until }
            | Self::Connected {
                redial: Redial::Waiting { until },
                ..
            } => Some(until),
            _ => None,
        }
    }
}
