//! Two peers and the link between them, in virtual time.
#![allow(dead_code, reason = "each test uses its own part")]

use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap},
    net::SocketAddr,
    time::Duration,
};

use quinn_proto::ConnectionHandle;
use sm2_gateway::{
    Counts,
    clock::{Clock, Now},
    peer::{Command, Event, Limits, Me, Peer},
};
use sm2_io::quic::{Arrival, Congestion, Endpoint, SecretKey, Trusted};
use sm2_proto::{
    Instant, Name,
    gateway::{Hop, SubjectKind},
};

/// A link, each way.
#[derive(Clone, Copy)]
pub(crate) struct Link {
    pub(crate) rate_bit: f64,
    pub(crate) loss_permille: u64,
    pub(crate) delay: Duration,
    /// A datagram that would wait longer is lost.
    pub(crate) queue: Duration,
}

/// Bytes of IP and UDP headers.
pub(crate) const HEADERS_BYTES: usize = 28;

struct Side {
    endpoint: Endpoint,
    me: Me,
    peer: Option<(ConnectionHandle, Peer)>,
    address: SocketAddr,
    /// When its way has carried all that it was given.
    free: Instant,
}

/// A datagram on its way: when it arrives, its number, to which side.
type Flying = Reverse<(Instant, u64, usize, Vec<u8>)>;

/// What counts are of.
pub(crate) type Named = (SubjectKind, Name);

/// The near side is 0, and dials.
pub(crate) struct World {
    pub(crate) now: Instant,
    clock: Clock,
    link: Link,
    sides: [Side; 2],
    flying: BinaryHeap<Flying>,
    count: u64,
    random: u64,
}

impl World {
    pub(crate) fn new(link: Link, congestion: Congestion) -> Self {
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
                free: now,
            }
        });
        let mut world = Self {
            now,
            clock,
            link,
            sides,
            flying: BinaryHeap::new(),
            count: 0,
            random: 0x1234_5678_9abc_def1,
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

    /// What was counted at a side, in all and by name.
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
        let peer = Peer::new(connection, clock, me, BTreeMap::new(), Limits::default());
        self.sides[at].peer = Some((handle, peer));
    }

    fn random(&mut self) -> u64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        self.random
    }

    pub(crate) fn command(&mut self, at: usize, command: Command) {
        let moment = self.moment();
        if let Some((_, peer)) = &mut self.sides[at].peer {
            peer.command(moment, command);
        }
    }

    fn carry(&mut self, from: usize, bytes: &[u8]) {
        let begins = self.sides[from].free.max(self.now);
        if begins.since(self.now) > self.link.queue {
            return;
        }
        let bits = 8.0 * (bytes.len() + HEADERS_BYTES) as f64;
        let sent = begins.after(Duration::from_secs_f64(bits / self.link.rate_bit));
        self.sides[from].free = sent;
        if self.random() % 1_000 >= self.link.loss_permille {
            self.count += 1;
            let due = sent.after(self.link.delay);
            let datagram = (due, self.count, 1 - from, bytes.to_vec());
            self.flying.push(Reverse(datagram));
        }
    }

    /// Sends all that can be sent now.
    fn transmit(&mut self, at: usize) {
        let moment = self.moment();
        let mut buffer = Vec::new();
        loop {
            buffer.clear();
            let side = &mut self.sides[at];
            let Some((handle, peer)) = &mut side.peer else {
                return;
            };
            while let Some(event) = peer.poll_endpoint() {
                if let Some(answer) = side.endpoint.event(*handle, event) {
                    peer.handle_event(moment, answer);
                }
            }
            let Some(transmit) = peer.poll_transmit(moment, 1, &mut buffer) else {
                return;
            };
            self.carry(at, &buffer[..transmit.size]);
        }
    }

    fn deliver(&mut self, to: usize, bytes: &[u8]) {
        let (moment, from) = (self.moment(), self.sides[1 - to].address);
        let mut answer = Vec::new();
        let side = &mut self.sides[to];
        let arrival = (side.endpoint).handle(moment.quic, from, None, bytes, &mut answer);
        match arrival {
            Some(Arrival::New(handle, connection)) => self.open(to, handle, *connection),
            Some(Arrival::Event(_, event)) => {
                if let Some((_, peer)) = &mut side.peer {
                    peer.handle_event(moment, event);
                }
            }
            Some(Arrival::Answer(_)) | None => {}
        }
    }

    /// Lets time pass until something happens, but not beyond `until`; what happened, by the side.
    pub(crate) fn step(&mut self, until: Instant) -> Vec<(usize, Event)> {
        let (near, far) = (0, 1);
        self.transmit(near);
        self.transmit(far);
        let peers = self.sides.iter_mut().filter_map(|it| it.peer.as_mut());
        let timers = peers.filter_map(|(_, peer)| peer.deadline());
        let arrival = self.flying.peek().map(|Reverse((due, ..))| *due);
        let next = timers.chain(arrival).min().unwrap_or(until);
        self.now = next.min(until).max(self.now);
        while let Some(Reverse((due, ..))) = self.flying.peek()
            && *due <= self.now
        {
            let Reverse((_, _, to, bytes)) = self.flying.pop().unwrap();
            self.deliver(to, &bytes);
        }
        let moment = self.moment();
        let mut events = Vec::new();
        for (at, side) in self.sides.iter_mut().enumerate() {
            let Some((_, peer)) = &mut side.peer else {
                continue;
            };
            if peer.deadline().is_some_and(|it| it <= self.now) {
                peer.handle_timeout(moment);
            }
            while let Some(event) = peer.poll() {
                events.push((at, event));
            }
        }
        events
    }
}
