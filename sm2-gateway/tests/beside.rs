//! The messages that a peer gets beside peers whose links are slow or cut, in virtual time. All connections share the
//! memory of one gateway. `examples/beside` measures the same with real links.

use std::time::Duration;

use crate::age::world::World;
use bytes::Bytes;
use sm2_gateway::{
    hub::DEFAULT_SEND_QOS,
    peer::{Budget, Command, Event, Message},
};
use sm2_io::quic::Congestion;
use sm2_lossy_link::Profile;
use sm2_proto::{
    Instant, Name, TypeId,
    gateway::{
        OfferId, Subject,
        session::{self, ControlCommand},
    },
};

const OFFER: OfferId = OfferId(1);
const SETTLING: Duration = Duration::from_millis(500);
const LENGTH: Duration = Duration::from_secs(2);
/// The memory of the gateway: each of nine connections may keep two of the longest messages.
const GATEWAY_BYTES: u64 = 9 * 2_100_000;
/// The lengths of messages in bytes, and their periods.
const STREAMS: [(usize, Duration); 3] = [
    (1_000, Duration::from_millis(2)),
    (100_000, Duration::from_millis(33)),
    (1_000_000, Duration::from_millis(100)),
];

/// The streams of the test. Most of them take long to simulate.
fn streams() -> &'static [(usize, Duration)] {
    if cfg!(feature = "slow") {
        &STREAMS
    } else {
        &STREAMS[1..2]
    }
}

/// The depths of the subscribers.
const DEPTHS: &[u16] = if cfg!(feature = "slow") {
    &[1, 16, 1_024]
} else {
    &[16]
};
/// How many bad links there are.
const BAD: &[usize] = if cfg!(feature = "slow") {
    &[1, 8]
} else {
    &[8]
};

/// The quality of a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Link {
    Good,
    /// 50 kbit/s.
    Slow,
    /// 1 Mbit/s.
    Narrow,
    /// All datagrams are lost after the first messages.
    Cut,
}

impl Link {
    fn profile(self) -> Profile {
        Profile {
            rate_bit: match self {
                Self::Good | Self::Cut => 400e6,
                Self::Slow => 50e3,
                Self::Narrow => 1e6,
            },
            loss_permille: 0,
            jitter: Duration::ZERO,
            pauses: Vec::new(),
            ..Profile::wifi()
        }
    }
}

/// A connection of the gateway, whose peer wants the topic.
struct Connection {
    world: World,
    begin: Instant,
    link: Link,
    depth: u16,
    received: u64,
}

impl Connection {
    fn new(link: Link, depth: u16, memory: &Budget) -> Self {
        let world = World::with_budget(&link.profile(), Congestion::Steady, memory.clone());
        Self {
            begin: world.now,
            world,
            link,
            depth,
            received: 0,
        }
    }

    /// Runs until this time after the begin.
    fn run(&mut self, until: Duration) {
        let until = self.begin.after(until);
        while self.world.now < until {
            for (at, event) in self.world.step(until) {
                self.event(at, event);
            }
        }
    }

    fn event(&mut self, at: usize, event: Event) {
        let depth = self.depth;
        match (at, event) {
            (0, Event::Session(session::Event::Greeted { .. })) => {
                let name = Name::new("topic").unwrap();
                let data = TypeId {
                    name: name.clone(),
                    hash: 1,
                };
                let subject = Subject::Topic {
                    name,
                    data,
                    reliable: false,
                    latched: 0,
                };
                let path = vec![self.world.hop(0)];
                let (offer, qos) = (OFFER, DEFAULT_SEND_QOS);
                self.world.command(
                    0,
                    Command::Offer {
                        offer,
                        subject,
                        path,
                        qos,
                    },
                );
            }
            (1, Event::Session(session::Event::Offered { offer, .. })) => {
                let want = ControlCommand::Want { offer, depth };
                self.world.command(1, Command::Control(want));
            }
            (1, Event::Message { .. }) => self.received += 1,
            _ => {}
        }
    }

    fn publish(&mut self, sequence: u64, payload: &Bytes) {
        let message = Message {
            sequence,
            published_at: self.world.now,
            payload: payload.clone(),
        };
        let offer = OFFER;
        self.world.command(0, Command::Message { offer, message });
    }
}

/// How many messages the first of these links carries, and how many were published.
fn carried(links: &[Link], (len_bytes, period): (usize, Duration), depth: u16) -> (u64, u64) {
    let memory = Budget::new(GATEWAY_BYTES);
    let connection = |link: &Link| Connection::new(*link, depth, &memory);
    let mut connections: Vec<Connection> = links.iter().map(connection).collect();
    let payload = Bytes::from(vec![7; len_bytes]);
    let (mut now, mut published) = (SETTLING, 0);
    while now < SETTLING + LENGTH {
        published += 1;
        for it in &mut connections {
            it.run(now);
            if it.link == Link::Cut && now > SETTLING * 2 {
                it.world.loss_permille = 1_000;
            }
            it.publish(published, &payload);
        }
        now += period;
    }
    let good = &mut connections[0];
    // The last messages arrive.
    good.run(now + SETTLING);
    (good.received, published)
}

#[test]
fn a_peer_gets_the_same_beside_bad_ones() {
    for &stream in streams() {
        for &depth in DEPTHS {
            let (alone, published) = carried(&[Link::Good], stream, depth);
            // Most arrive: the congestion controller starts slowly.
            assert!(
                alone * 2 > published,
                "{stream:?} {depth}: {alone} of {published}"
            );
            for bad in [Link::Slow, Link::Narrow, Link::Cut] {
                for &count in BAD {
                    let links = [vec![Link::Good], vec![bad; count]].concat();
                    let (beside, _) = carried(&links, stream, depth);
                    println!("{stream:?}, depth {depth}, {count} {bad:?}: {beside} of {alone}");
                    assert!(beside * 100 >= alone * 97, "{beside} of {alone}");
                }
            }
        }
    }
}
