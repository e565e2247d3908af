//! The cost of an operation of the Manager in a small domain and in a large one.
//!
//! Each repetition declares a subscriber, which is linked with one publisher, and withdraws it
//! again. All frames are encoded as usual.
//!
//! `cargo run --release -p sm2-proto --example registry_cost`

use std::time::{Duration, Instant as Clock};

use sm2_proto::{
    Code, Contract, Datagram, DemandedQos, Instant, InterfaceId, LinkId, Machine, Name, NodeId,
    OfferedQos, TypeId,
    control::{Limits, ToManager, encode_to_manager},
    manager::{Credentials, Input, Manager, Output},
};

const SMALL: u64 = 50;
const LARGE: u64 = 5_000;
/// Interfaces of one session.
const PER_SESSION: u64 = 50;
const REPETITIONS: u64 = 20_000;
/// The limit of the ratio between the costs in a large domain and in a small one.
const ALLOWED: f64 = 2.0;

fn main() {
    let mut domains = [SMALL, LARGE].map(Domain::new);
    let mut costs = [const { Vec::new() }; 2];
    // The two domains take turns, so that other load of the machine affects both alike.
    for repetition in 0..REPETITIONS {
        for (domain, costs) in domains.iter_mut().zip(&mut costs) {
            costs.push(domain.declare_and_withdraw(repetition));
        }
    }
    let [small, large] = costs.map(median);
    println!("{SMALL:>5} interfaces: {small:?} to declare, link and withdraw (median)");
    println!("{LARGE:>5} interfaces: {large:?}");
    let ratio = large.as_secs_f64() / small.as_secs_f64();
    println!("ratio {ratio:.2}, allowed {ALLOWED}");
    if ratio > ALLOWED {
        std::process::exit(1);
    }
}

fn median(mut costs: Vec<Duration>) -> Duration {
    costs.sort();
    costs[costs.len() / 2]
}

/// Publishers on as many topics, and one session that comes and goes.
struct Domain {
    manager: Manager,
    interfaces: u64,
    visitor: NodeId,
    links: u64,
}

impl Domain {
    fn new(interfaces: u64) -> Self {
        let sessions = interfaces / PER_SESSION;
        let visitor = NodeId(sessions + 1);
        let mut domain = Self {
            manager: Manager::new(1, 7, Limits::default()),
            interfaces,
            visitor,
            links: 0,
        };
        for session in (1..=visitor.0).map(NodeId) {
            let credentials = Credentials {
                uid: 1000,
                gid: 1000,
                pid: 1,
            };
            domain.feed(Input::Connected {
                session,
                credentials,
            });
            domain.send(
                session,
                &ToManager::Hello {
                    min_version: 1,
                    max_version: 1,
                    name: name(format!("node-{}", session.0)),
                    resuming: false,
                },
            );
        }
        for at in 0..interfaces {
            let offer = OfferedQos {
                reliable: true,
                ..OfferedQos::new(8)
            };
            domain.send(
                NodeId(at / PER_SESSION + 1),
                &ToManager::Declare {
                    interface: InterfaceId(at % PER_SESSION + 1),
                    contract: Contract::Publisher {
                        topic: topic(at),
                        data: data(),
                        offer,
                    },
                },
            );
        }
        domain
    }

    fn declare_and_withdraw(&mut self, repetition: u64) -> Duration {
        let at = repetition * 7_919 % self.interfaces;
        let interface = InterfaceId(repetition + 1);
        let demand = DemandedQos {
            reliable: true,
            ..DemandedQos::new(8, 2)
        };
        let declare = ToManager::Declare {
            interface,
            contract: Contract::Subscriber {
                topic: topic(at),
                data: Some(data()),
                demand,
            },
        };
        self.links += 1;
        let (epoch, serial) = (1, self.links);
        // The publisher's answer to UNLINK.
        let unlinked = ToManager::Unlinked {
            interface: InterfaceId(at % PER_SESSION + 1),
            link: LinkId { epoch, serial },
            code: Code(0),
        };
        let frames = [
            (self.visitor, declare),
            (self.visitor, ToManager::Withdraw { interface }),
            (NodeId(at / PER_SESSION + 1), unlinked),
        ]
        .map(|(session, frame)| (session, encode_to_manager(&frame)));
        let start = Clock::now();
        for (session, frame) in &frames {
            let datagram = Datagram::new(frame);
            self.feed(Input::Datagram {
                session: *session,
                datagram,
            });
        }
        start.elapsed()
    }

    fn send(&mut self, session: NodeId, frame: &ToManager) {
        let frame = encode_to_manager(frame);
        let datagram = Datagram::new(&frame);
        self.feed(Input::Datagram { session, datagram });
    }

    fn feed(&mut self, input: Input<'_>) {
        let taken = self.manager.handle(Instant(0), input);
        taken.expect("session numbers grow");
        let mut linked = None;
        while let Some(output) = self.manager.poll() {
            let over = matches!(output, Output::HangUp { .. });
            assert!(!over, "everybody keeps to SPEC: {output:?}");
            if let Output::Link { ends, .. } = output {
                linked = Some(ends.map(|(session, _)| session));
            }
        }
        // All nodes read at once.
        for session in linked.into_iter().flatten() {
            if self.manager.awaits_room(session) {
                let drained = self.manager.handle(Instant(0), Input::Drained { session });
                drained.expect("that is not a connection");
            }
        }
    }
}

fn name(text: String) -> Name {
    Name::new(&text).expect("it keeps to the grammar")
}

fn topic(at: u64) -> Name {
    name(format!("robot/{at:05}/scan"))
}

fn data() -> TypeId {
    TypeId {
        name: name("Scan".into()),
        hash: 1,
    }
}
