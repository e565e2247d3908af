//! How long a gateway's hub occupies itself in one piece, with 16,384 routes.
//!
//! `cargo run --release -p sm2-gateway --example busy`
//!
//! Four peers offer as much as a peer may, and each offer is wanted by another peer. A piece is one input of the
//! hub with all its outputs. The hub serves other events between two pieces. The times are processor times.

use std::time::Duration;

use nix::time::{ClockId, clock_gettime};
use sm2_gateway::{
    hub::{Hub, Input, Output, Policy},
    peer::{Command, ConnectionId, Event, HandshakeError, Reason},
};
use sm2_proto::{
    Instant, Machine, Name, NameError, TypeId,
    gateway::{
        Action, GatewayId, Hop, OfferId, Pattern, Rule, Rules, Subject,
        session::{self, Initiator},
    },
    limits::OFFERS_MAX,
};

const PEERS: u8 = 4;

/// A hub, and what its pieces have cost since the last look.
struct Bench {
    hub: Hub,
    pieces: u64,
    longest: Duration,
    total: Duration,
    /// The offers to peers.
    offers: Vec<(ConnectionId, OfferId)>,
}

impl Bench {
    fn new() -> Result<Self, NameError> {
        let mut bench = Self {
            hub: Hub::new(hop(100), policy(Action::Allow)),
            pieces: 0,
            longest: Duration::ZERO,
            total: Duration::ZERO,
            offers: Vec::new(),
        };
        for peer in 1..=PEERS {
            bench.greet(peer, peer.into())?;
        }
        for number in 0..u64::from(PEERS) * OFFERS_MAX as u64 {
            let peer = (number % u64::from(PEERS)) as u8 + 1;
            let mut origin = hop(200);
            origin.gateway.0[..8].copy_from_slice(&number.to_le_bytes());
            let name = Name::new(&format!("robot/topic-{number}"))?;
            let data = TypeId {
                name: Name::new("bytes")?,
                hash: 0,
            };
            let subject = Subject::Topic {
                name,
                data,
                reliable: false,
                latched: 0,
            };
            let offered = session::Event::Offered {
                offer: OfferId(number / u64::from(PEERS) + 1),
                subject,
                path: vec![origin, hop(peer)],
            };
            bench.event(peer.into(), Event::Session(offered));
        }
        for (connection, offer) in std::mem::take(&mut bench.offers).into_iter().step_by(3) {
            let wanted = session::Event::Wanted { offer, depth: 1 };
            bench.event(connection.0, Event::Session(wanted));
        }
        bench.reset();
        Ok(bench)
    }

    const fn reset(&mut self) {
        (self.pieces, self.longest, self.total) = (0, Duration::ZERO, Duration::ZERO);
    }

    fn greet(&mut self, peer: u8, connection: u64) -> Result<(), NameError> {
        let Hop { gateway, epoch } = hop(peer);
        let greeted = session::Event::Greeted {
            peer: gateway,
            epoch,
            name: Name::new(&format!("peer-{peer}"))?,
        };
        self.event(connection, Event::Session(greeted));
        Ok(())
    }

    fn event(&mut self, connection: u64, event: Event) {
        self.feed(Input::Peer {
            connection: ConnectionId(connection),
            initiator: Initiator::Peer,
            event,
        });
    }

    /// Feeds one input, and all ticks that its work needs.
    fn feed(&mut self, input: Input) {
        let mut next = Some(input);
        while let Some(input) = next {
            self.piece(|hub| {
                let Ok(()) = hub.handle(Instant(0), input);
            });
            next = self.hub.deadline().map(|_| Input::Tick);
        }
    }

    fn piece(&mut self, work: impl FnOnce(&mut Hub)) {
        let before = processor_time();
        work(&mut self.hub);
        let mut outputs = Vec::new();
        outputs.extend(std::iter::from_fn(|| self.hub.poll()));
        let cost = processor_time().saturating_sub(before);
        self.pieces += 1;
        self.longest = self.longest.max(cost);
        self.total += cost;
        for output in outputs {
            if let Output::Peer {
                connection,
                command: Command::Offer { offer, .. },
            } = output
            {
                self.offers.push((connection, offer));
            }
        }
    }

    fn print(&mut self, what: &str) {
        let Self {
            pieces,
            longest,
            total,
            ..
        } = *self;
        println!("{what:<28} {pieces:>7} {longest:>9.2?} {total:>9.2?}");
        self.reset();
    }
}

fn hop(number: u8) -> Hop {
    Hop {
        gateway: GatewayId([number; 32]),
        epoch: 1,
    }
}

fn policy(action: Action) -> Policy {
    let rule = |names| Rule {
        action,
        kind: None,
        names,
        direction: None,
        peers: None,
    };
    Policy {
        rules: Rules(Pattern::new("**").into_iter().map(rule).collect()),
        send_qos: Vec::new(),
    }
}

fn processor_time() -> Duration {
    clock_gettime(ClockId::CLOCK_THREAD_CPUTIME_ID).map_or(Duration::ZERO, Duration::from)
}

fn main() -> Result<(), NameError> {
    println!(
        "{:<28} {:>7} {:>9} {:>9}",
        "work", "pieces", "longest", "total"
    );
    let mut bench = Bench::new()?;
    bench.event(1, Event::Ended(Reason::Handshake(HandshakeError::NoKey)));
    bench.print("end of a connection");
    bench.greet(1, 11)?;
    bench.print("start of a connection");
    bench.piece(|hub| drop(hub.peers()));
    bench.print("report");
    bench.piece(|hub| drop(hub.seen()));
    bench.print("view for shadow rules");
    bench.feed(Input::Policy(policy(Action::Deny)));
    bench.print("rules that deny everything");
    bench.feed(Input::Policy(policy(Action::Allow)));
    bench.print("rules that allow everything");
    Ok(())
}
