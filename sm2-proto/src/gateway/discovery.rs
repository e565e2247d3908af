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
const LONGEST: Duration = Duration::from_secs(5);
/// Of beacons.
const PERIOD: Duration = Duration::from_secs(1);

/// An input of discovery. Inputs about a peer that is not trusted are ignored. [`Input::Failed`]
/// may come while outputs wait: the attempt that [`Output::Dial`] asked for could not begin.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input<'a> {
    /// The configuration names a peer, perhaps one that it named before.
    Trust {
        /// Whom.
        peer: GatewayId,
        /// Where it may be, besides where beacons say.
        addresses: Vec<SocketAddr>,
    },
    /// The configuration also has names of hosts for a peer, which the driver looks up: so many.
    Named {
        /// Of whom.
        peer: GatewayId,
        /// How many.
        hosts: usize,
    },
    /// The configuration does not name it any more.
    Distrust {
        /// Whom.
        peer: GatewayId,
    },
    /// A datagram came to the group.
    Beacon {
        /// Where it came from.
        from: SocketAddr,
        /// What it is.
        bytes: &'a [u8],
    },
    /// There is a connection with this peer, whoever opened it.
    Connected {
        /// With whom.
        peer: GatewayId,
        /// Of its process.
        epoch: u64,
    },
    /// There is none any more.
    Lost {
        /// With whom.
        peer: GatewayId,
    },
    /// The attempt to connect to this peer led to nothing.
    Failed {
        /// To whom.
        peer: GatewayId,
    },
    /// Time has passed.
    Tick,
}

/// What is to be done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Output {
    /// Try to connect; answer with [`Input::Connected`] or [`Input::Failed`].
    Dial {
        /// To whom.
        peer: GatewayId,
        /// Where.
        address: SocketAddr,
    },
    /// Look up the name of a host, and try to connect; answer likewise.
    DialHost {
        /// To whom.
        peer: GatewayId,
        /// Which of its hosts, from 0.
        host: usize,
    },
    /// Send a beacon.
    Announce,
}

/// Where peers are.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Discovery {
    me: GatewayId,
    peers: BTreeMap<GatewayId, Peer>,
    /// When to try whom.
    due: BTreeSet<(Instant, GatewayId)>,
    /// When the next beacon is sent, if any.
    announce_at: Option<Instant>,
    /// When beacons were first looked at in this second, and how many since.
    looked: (Instant, u32),
    /// For the moments of beacons, and the seeds of peers.
    random: Backoff,
    outputs: VecDeque<Output>,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Peer {
    configured: Vec<SocketAddr>,
    /// How many names of hosts there are besides.
    hosts: usize,
    /// From beacons, the newest first.
    heard: [Option<SocketAddr>; 2],
    backoff: Backoff,
    /// The next of the places.
    turn: usize,
    state: State,
}

/// Where a peer may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Where {
    At(SocketAddr),
    Host(usize),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum State {
    /// Nowhere to look for it.
    Unknown,
    Waiting {
        until: Instant,
    },
    Dialing,
    Connected {
        since: Instant,
        epoch: u64,
        hint: Hint,
    },
}

/// Whether a beacon said that there is a newer process than the one of the connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Hint {
    None,
    Waiting { until: Instant },
    Dialing,
}

impl Discovery {
    /// A gateway that knows nobody. `seed`: another one for each process; `announces`: whether it
    /// wants to be found.
    #[must_use]
    pub fn new(now: Instant, me: GatewayId, seed: u64, announces: bool) -> Self {
        Self {
            me,
            peers: BTreeMap::new(),
            due: BTreeSet::new(),
            announce_at: announces.then_some(now),
            looked: (now, 0),
            random: Backoff::new(seed, LONGEST),
            outputs: VecDeque::new(),
        }
    }

    fn input(&mut self, now: Instant, input: Input<'_>) {
        match input {
            Input::Trust { peer, addresses } => self.trust(now, peer, addresses),
            Input::Named { peer, hosts } => self.named(now, peer, hosts),
            Input::Distrust { peer } => self.distrust(peer),
            Input::Beacon { from, bytes } => self.beacon(now, from, bytes),
            Input::Connected { peer, epoch } => {
                let hint = Hint::None;
                let since = now;
                self.enter(peer, State::Connected { since, epoch, hint });
            }
            Input::Lost { peer } => self.lost(now, peer),
            Input::Failed { peer } => self.failed(now, peer),
            Input::Tick => {}
        }
    }

    fn trust(&mut self, now: Instant, peer: GatewayId, addresses: Vec<SocketAddr>) {
        let seed = self.random.random();
        let it = self.peers.entry(peer).or_insert_with(|| Peer {
            configured: Vec::new(),
            hosts: 0,
            heard: [None; 2],
            backoff: Backoff::new(seed, LONGEST),
            turn: 0,
            state: State::Unknown,
        });
        it.configured = addresses;
        self.look_again(now, peer);
    }

    fn named(&mut self, now: Instant, peer: GatewayId, hosts: usize) {
        if let Some(it) = self.peers.get_mut(&peer) {
            it.hosts = hosts;
            self.look_again(now, peer);
        }
    }

    /// There are other places where a peer may be.
    fn look_again(&mut self, now: Instant, peer: GatewayId) {
        let Some(it) = self.peers.get(&peer) else {
            return;
        };
        match it.state {
            State::Waiting { .. } if it.places().next().is_none() => {
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
        if now.since(self.looked.0) >= PERIOD {
            self.looked = (now, 0);
        }
        if self.looked.1 >= BEACONS_PER_S {
            return;
        }
        self.looked.1 += 1;
        let Ok(beacon) = Beacon::from_bytes(bytes) else {
            return;
        };
        let gateway = beacon.gateway;
        let Some(peer) = self.peers.get_mut(&gateway).filter(|_| gateway != self.me) else {
            return;
        };
        let mut address = from;
        address.set_port(beacon.port);
        peer.hear(address);
        match peer.state {
            State::Unknown => self.wait(now, gateway),
            State::Connected {
                since,
                epoch,
                hint: Hint::None,
            } if beacon.epoch > epoch => {
                let until = now.after(peer.backoff.wait());
                let hint = Hint::Waiting { until };
                self.enter(gateway, State::Connected { since, epoch, hint });
            }
            State::Waiting { .. } | State::Dialing | State::Connected { .. } => {}
        }
    }

    fn lost(&mut self, now: Instant, peer: GatewayId) {
        let Some(it) = self.peers.get_mut(&peer) else {
            return;
        };
        if let State::Connected { since, hint, .. } = it.state {
            it.backoff.ended_after(now.since(since));
            match hint {
                // An attempt is under way already.
                Hint::Dialing => self.enter(peer, State::Dialing),
                Hint::None | Hint::Waiting { .. } => self.wait(now, peer),
            }
        }
    }

    fn failed(&mut self, now: Instant, peer: GatewayId) {
        match self.peers.get(&peer).map(|it| it.state) {
            Some(State::Dialing) => self.wait(now, peer),
            Some(State::Connected {
                since,
                epoch,
                hint: Hint::Dialing,
            }) => {
                let hint = Hint::None;
                self.enter(peer, State::Connected { since, epoch, hint });
            }
            _ => {}
        }
    }

    /// The peer has no connection: waits for the next attempt, if there is anywhere to look.
    fn wait(&mut self, now: Instant, peer: GatewayId) {
        let Some(it) = self.peers.get_mut(&peer) else {
            return;
        };
        let is_somewhere = it.places().next().is_some();
        let state = if is_somewhere {
            let until = now.after(it.backoff.wait());
            State::Waiting { until }
        } else {
            State::Unknown
        };
        self.enter(peer, state);
    }

    /// The one place where a state changes: its timer with it.
    fn enter(&mut self, peer: GatewayId, state: State) {
        let Some(it) = self.peers.get_mut(&peer) else {
            return;
        };
        if let Some(at) = it.state.until() {
            self.due.remove(&(at, peer));
        }
        it.state = state;
        if let Some(at) = state.until() {
            self.due.insert((at, peer));
        }
    }

    /// What is due.
    fn act(&mut self, now: Instant) {
        while let Some(&(_, peer)) = self.due.first().filter(|(at, _)| *at <= now) {
            let Some(it) = self.peers.get_mut(&peer) else {
                return;
            };
            let place = it.next_place();
            let state = match it.state {
                State::Connected { since, epoch, .. } => {
                    let hint = place.map_or(Hint::None, |_| Hint::Dialing);
                    State::Connected { since, epoch, hint }
                }
                _ if place.is_some() => State::Dialing,
                _ => State::Unknown,
            };
            self.enter(peer, state);
            let dial = place.map(|place| match place {
                Where::At(address) => Output::Dial { peer, address },
                Where::Host(host) => Output::DialHost { peer, host },
            });
            self.outputs.extend(dial);
        }
        //= SM2-GWD-005
        if self.announce_at.is_some_and(|at| at <= now) {
            self.outputs.push_back(Output::Announce);
            let less = self.random.random_up_to(PERIOD / 2);
            self.announce_at = Some(now.after(PERIOD - less));
        }
    }

    /// What must hold between any two calls.
    fn invariants(&self) {
        let due = |(id, it): (&GatewayId, &Peer)| it.state.until().map(|at| (at, *id));
        debug_assert_eq!(self.peers.iter().filter_map(due).count(), self.due.len());
        debug_assert!(
            self.peers
                .iter()
                .filter_map(due)
                .all(|it| self.due.contains(&it))
        );
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
        self.act(now);
        self.invariants();
        Ok(())
    }

    fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    fn deadline(&self) -> Option<Instant> {
        let due = self.due.first().map(|(at, _)| *at);
        due.into_iter().chain(self.announce_at).min()
    }
}

impl Peer {
    /// First those of the configuration.
    fn places(&self) -> impl Iterator<Item = Where> {
        let heard = self.heard.iter().flatten().copied();
        let configured = self.configured.iter().copied();
        let hosts = (0..self.hosts).map(Where::Host);
        let configured = configured.map(Where::At).chain(hosts);
        configured.chain(heard.map(Where::At))
    }

    /// Each in turn.
    fn next_place(&mut self) -> Option<Where> {
        let place = self.places().nth(self.turn);
        let place = place.or_else(|| {
            self.turn = 0;
            self.places().next()
        });
        self.turn += 1;
        place
    }

    fn hear(&mut self, address: SocketAddr) {
        let [newest, before] = &mut self.heard;
        if *newest != Some(address) {
            *before = newest.replace(address);
        }
    }
}

impl State {
    const fn until(self) -> Option<Instant> {
        match self {
            Self::Waiting { until }
            | Self::Connected {
                hint: Hint::Waiting { until },
                ..
            } => Some(until),
            _ => None,
        }
    }
}
