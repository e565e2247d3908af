//! Two connections with one peer: both sides keep the same connection, whichever greets first.

// Shows GW-EPOCH (test, full), bound: two connections at once, over QUIC on this machine.

use std::time::Duration;

use crate::age::world::World;
use sm2_gateway::{
    hub::{Hub, Input, Output, Policy},
    peer::{Command, ConnectionId, Event, Reason},
};
use sm2_io::quic::Congestion;
use sm2_lossy_link::Profile;
use sm2_proto::{
    Code, Instant, Machine, Name,
    gateway::{
        GatewayId, Hop, PeerFarewell,
        session::{self, End, Initiator},
    },
};

const SMALL: GatewayId = GatewayId([1; 32]);
const GREAT: GatewayId = GatewayId([2; 32]);

/// Greets on connections 1 and 2, each given by the peer's epoch and its initiator. Returns the
/// connection that the gateway closes, and the code.
fn closed(me: GatewayId, peer: GatewayId, greeted: [(u64, Initiator); 2]) -> (u64, Code) {
    let gateway = me;
    let mut hub = Hub::new(Hop { gateway, epoch: 1 }, Policy::default());
    let mut closed = Vec::new();
    for (connection, (epoch, initiator)) in (1..).zip(greeted) {
        let name = Name::new("peer").unwrap();
        let event = Event::Session(session::Event::Greeted { peer, epoch, name });
        let input = Input::Peer {
            connection: ConnectionId(connection),
            initiator,
            event,
        };
        let Ok(()) = hub.handle(Instant(0), input);
        while let Some(output) = hub.poll() {
            if let Output::Peer {
                connection,
                command: Command::Close(code),
            } = output
            {
                closed.push((connection.0, code));
            }
        }
    }
    let left = hub.peers();
    assert_eq!((closed.len(), left.len()), (1, 1));
    assert_eq!(
        left[0].connection.0,
        3 - closed[0].0,
        "the other one is used"
    );
    closed[0]
}

//= SM2-GWC-004 test
#[test]
fn of_two_connections_both_sides_keep_the_same() {
    let (stale, duplicate) = (PeerFarewell::Stale.code(), PeerFarewell::Duplicate.code());
    let (ours, its) = (Initiator::ThisGateway, Initiator::Peer);
    // The greater epoch wins, whichever side opened the connection.
    for (first, second) in [(ours, ours), (ours, its), (its, ours), (its, its)] {
        for (me, peer) in [(SMALL, GREAT), (GREAT, SMALL)] {
            assert_eq!(closed(me, peer, [(7, first), (8, second)]), (1, stale));
            assert_eq!(closed(me, peer, [(8, first), (7, second)]), (2, stale));
        }
    }
    // With equal epochs, the connection opened by the gateway with the smaller id wins.
    assert_eq!(closed(SMALL, GREAT, [(7, ours), (7, its)]), (2, duplicate));
    assert_eq!(closed(SMALL, GREAT, [(7, its), (7, ours)]), (1, duplicate));
    assert_eq!(closed(GREAT, SMALL, [(7, its), (7, ours)]), (2, duplicate));
    assert_eq!(closed(GREAT, SMALL, [(7, ours), (7, its)]), (1, duplicate));
}

/// The other side learns why, so that it knows whether to dial again.
//= SM2-GWE-001 test
#[test]
fn a_connection_ends_with_its_code_at_both_sides() {
    let link = Profile {
        rate_bit: 1e9,
        loss_permille: 0,
        delay: Duration::from_millis(1),
        jitter: Duration::ZERO,
        queue: Duration::from_secs(1),
        pauses: Vec::new(),
        seed: 1,
    };
    for farewell in [
        PeerFarewell::Stale,
        PeerFarewell::Duplicate,
        PeerFarewell::Done,
    ] {
        let code = farewell.code();
        let mut world = World::new(&link, Congestion::Steady);
        let until = world.now.after(Duration::from_secs(2));
        let mut reasons = Vec::new();
        let mut greeted = 0;
        while world.now < until {
            for (at, event) in world.step(until) {
                match event {
                    Event::Session(session::Event::Greeted { .. }) => greeted += 1,
                    Event::Ended(reason) => reasons.push((at, reason)),
                    _ => {}
                }
            }
            if greeted == 2 {
                greeted = 0;
                world.command(0, Command::Close(code));
            }
        }
        let expected = [
            (0, Reason::Session(End::Local(code))),
            (1, Reason::Session(End::Closed(Some(code)))),
        ];
        assert_eq!(reasons, expected, "{farewell:?}");
    }
}
