//! Two connections with one peer: both sides keep the same connection, whichever greets first.

use sm2_gateway::{
    hub::{Hub, Input, Output, Policy},
    peer::{Command, ConnectionId, Event},
};
use sm2_proto::{
    Code, Instant, Machine, Name,
    gateway::{
        GatewayId, Hop, PeerFarewell,
        session::{self, Initiator},
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
