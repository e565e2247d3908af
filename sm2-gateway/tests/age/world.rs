//! Two peers and the link between them, in virtual time.
#![allow(dead_code, reason = "each test uses its own part")]

use std::{collections::BTreeMap, net::SocketAddr};

use quinn_proto::ConnectionHandle;
use sm2_gateway::{
    Counts,
    clock::{Clock, Now},
    peer::{Budget, Command, Event, Input, Limits, Me, Output, Peer},
};
use sm2_io::quic::{Arrival, Congestion, Endpoint, SecretKey, Trusted};
use sm2_lossy_link::{Lane, Profile};
use sm2_proto::{
    Instant, Machine, Name,
    gateway::{Hop, SubjectKind},
};

/// How many datagrams a system call of Linux can send.
const SEGMENTS_MAX: usize = 64;
/// The most bytes of them together: an IPv4 packet less the headers of IP and UDP.
const UDP_PAYLOAD_MAX: usize = 65_535 - 20 - 8;

struct Side {
    endpoint: Endpoint,
    me: Me,
    peer: Option<(ConnectionHandle, Peer)>,
    address: SocketAddr,
    /// Carries datagrams from this side to the other.
    lane: Lane<Vec<u8>>,
}

/// The kind and name of the subject that counts belong to.
pub(crate) type Named = (SubjectKind, Name);

/// Two sides. Side 0 is the near one, and dials.
pub(crate) struct World {
    pub(crate) now: Instant,
    clock: Clock,
    pub(crate) loss_permille: u32,
    limits: [Limits; 2],
    sides: [Side; 2],
    /// The memory of the gateway at each side.
    pub(crate) budgets: [Budget; 2],
    /// Each event with the index of its side.
    events: Vec<(usize, Event)>,
}

impl World {
    pub(crate) fn new(link: &Profile, congestion: Congestion) -> Self {
        Self::with_limits(link, congestion, Limits::default())
    }

    /// Two sides; the near one has these limits.
    pub(crate) fn with_limits(link: &Profile, congestion: Congestion, near: Limits) -> Self {
        Self::with_memory(link, congestion, near, Budget::new(near.gateway_bytes))
    }

    /// Two sides; the near one has this memory.
    pub(crate) fn with_budget(link: &Profile, congestion: Congestion, near: Budget) -> Self {
        Self::with_memory(link, congestion, Limits::default(), near)
    }

    fn with_memory(link: &Profile, congestion: Congestion, limits: Limits, near: Budget) -> Self {
        let clock = Clock::of_the_machine();
        let now = sm2_io::clock::now();
        let keys = [(); 2].map(|()| SecretKey::generate().unwrap());
        let trusted = Trusted::default();
        trusted.set(keys.iter().map(SecretKey::id));
        let far = keys[1].id();
        let mut number = 0;
        let sides = keys.map(|key| {
            number += 1;
            let gateway = key.id();
            let seed = Some([number; 32]);
            Side {
                endpoint: Endpoint::new(key, trusted.clone(), congestion, seed).unwrap(),
                me: Me {
                    hop: Hop { gateway, epoch: 1 },
                    name: Name::new(&format!("side{number}")).unwrap(),
                },
                peer: None,
                address: SocketAddr::from(([10, 0, 0, number], 7_633)),
                lane: Lane::new(link, clock.at(now).quic, number.into()),
            }
        });
        let mut world = Self {
            now,
            clock,
            loss_permille: link.loss_permille,
            limits: [limits, Limits::default()],
            sides,
            budgets: [near, Budget::new(Limits::default().gateway_bytes)],
            events: Vec::new(),
        };
        let (quic, address) = (world.moment().quic, world.sides[1].address);
        let connected = world.sides[0].endpoint.connect(quic, far, address);
        let (handle, connection) = connected.unwrap();
        world.open(0, handle, connection);
        world
    }

    pub(crate) fn hop(&self, at: usize) -> Hop {
        self.sides[at].me.hop
    }

    /// Returns the counts of a side, in total and by name.
    pub(crate) fn counts(&self, at: usize) -> (Counts, Vec<(Named, Counts)>) {
        let (_, peer) = self.sides[at].peer.as_ref().unwrap();
        let by_name = peer.counts_by_name();
        let by_name = by_name.map(|(key, it)| (key.clone(), it)).collect();
        (peer.counts(), by_name)
    }

    fn moment(&self) -> Now {
        self.clock.at(self.now)
    }

    fn open(&mut self, at: usize, handle: ConnectionHandle, connection: quinn_proto::Connection) {
        let (clock, me) = (self.clock, self.sides[at].me.clone());
        let peer = Peer::new(connection, clock, me, BTreeMap::new(), self.limits[at]);
        let peer = peer.with_budget(self.budgets[at].clone());
        self.sides[at].peer = Some((handle, peer));
    }

    pub(crate) fn command(&mut self, at: usize, command: Command) {
        self.feed(at, Input::Command(command));
    }

    /// Feeds the peer of a side, if it has one, and carries out its outputs.
    fn feed(&mut self, at: usize, input: Input) {
        let side = &mut self.sides[at];
        let Some((handle, peer)) = &mut side.peer else {
            return;
        };
        let mut next = Some(input);
        while let Some(input) = next.take() {
            let Ok(()) = peer.handle(self.now, input);
            while let Some(output) = peer.poll() {
                match output {
                    Output::Event(event) => self.events.push((at, event)),
                    Output::Endpoint(event) => {
                        // Answers are rare, and each event has at most one.
                        let answer = side.endpoint.event(*handle, event);
                        next = answer.map(Input::Quic).or(next);
                    }
                }
            }
        }
    }

    fn carry(&mut self, from: usize, bytes: &[u8]) {
        let (now, loss_permille) = (self.moment().quic, self.loss_permille);
        let lane = &mut self.sides[from].lane;
        if let Some(sent) = lane.shape(now, bytes.len(), loss_permille) {
            lane.push(sent, bytes.to_vec());
        }
    }

    /// Sends everything that can be sent now.
    fn transmit(&mut self, at: usize) {
        let mut buffer = Vec::new();
        loop {
            buffer.clear();
            let Some((_, peer)) = &mut self.sides[at].peer else {
                return;
            };
            let Some(transmit) = peer.poll_transmit(self.now, SEGMENTS_MAX, &mut buffer) else {
                return;
            };
            // Linux refuses a longer one (EMSGSIZE), which counts as a loss of all its datagrams.
            if transmit.size > UDP_PAYLOAD_MAX {
                continue;
            }
            let len_bytes = transmit.segment_size.unwrap_or(transmit.size);
            for datagram in buffer[..transmit.size].chunks(len_bytes) {
                self.carry(at, datagram);
            }
        }
    }

    fn deliver(&mut self, to: usize, bytes: &[u8]) {
        let (moment, from) = (self.moment(), self.sides[1 - to].address);
        let mut answer = Vec::new();
        let side = &mut self.sides[to];
        let arrival = (side.endpoint).handle(moment.quic, from, None, bytes, &mut answer);
        match arrival {
            Some(Arrival::New(handle, connection)) => self.open(to, handle, *connection),
            Some(Arrival::Event(_, event)) => self.feed(to, Input::Quic(event)),
            Some(Arrival::Answer(_)) | None => {}
        }
    }

    /// Advances time until an event occurs, but not beyond `until`. Returns the events with their
    /// sides.
    pub(crate) fn step(&mut self, until: Instant) -> Vec<(usize, Event)> {
        let (near, far) = (0, 1);
        self.transmit(near);
        self.transmit(far);
        let clock = self.clock;
        let moments = self.sides.iter_mut().flat_map(|it| {
            let timer = it.peer.as_ref().and_then(|(_, peer)| peer.deadline());
            let arrival = it.lane.due().map(|due| clock.of(due));
            [timer, arrival]
        });
        let next = moments.flatten().min().unwrap_or(until);
        self.now = next.min(until).max(self.now);
        for from in [near, far] {
            let now = self.moment().quic;
            while let Some(bytes) = self.sides[from].lane.pop(now) {
                self.deliver(1 - from, &bytes);
            }
        }
        for at in [near, far] {
            let timer = self.sides[at].peer.as_ref();
            let timer = timer.and_then(|(_, peer)| peer.deadline());
            if timer.is_some_and(|it| it <= self.now) {
                self.feed(at, Input::Tick);
            }
        }
        std::mem::take(&mut self.events)
    }
}
