//! The choice between two connections with one peer (SM2-GWC-004).

use super::super::GatewayId;

/// The side that opened a connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Initiator {
    /// This gateway dialled the peer.
    ThisGateway,
    /// The peer dialled this gateway.
    Peer,
}

/// One of two connections with the same peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Candidate {
    /// The epoch in the peer's HELLO.
    pub epoch: u64,
    /// The side that opened the connection.
    pub initiator: Initiator,
}

/// Whether the older of two connections with `peer` stays; otherwise the newer one stays. The peer
/// decides the same, whichever connection it saw first, unless both have the same initiator.
//= SM2-GWC-004
#[must_use]
pub fn older_stays(me: GatewayId, peer: GatewayId, older: Candidate, newer: Candidate) -> bool {
    let rank = |it: Candidate| {
        let is_ours = it.initiator == Initiator::ThisGateway;
        let is_of_smaller_id = is_ours == (me < peer);
        (it.epoch, is_of_smaller_id)
    };
    rank(older) >= rank(newer)
}
