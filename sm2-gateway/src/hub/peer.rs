//! A connected peer, as the hub knows it.

use std::collections::BTreeMap;

use sm2_proto::{
    Name,
    gateway::{Hop, OfferId, Subject, session::Initiator},
};

use crate::{peer::ConnectionId, tally::Tally};

/// A connected peer.
#[derive(Debug)]
pub(super) struct Peer {
    /// The one connection that is used.
    pub(super) connection: ConnectionId,
    pub(super) initiator: Initiator,
    pub(super) epoch: u64,
    pub(super) name: Name,
    /// The offers of the peer: the subject of each, and its origin.
    pub(super) offers: BTreeMap<OfferId, (Subject, Hop)>,
    /// The offers to the peer.
    pub(super) offered: BTreeMap<OfferId, Subject>,
    /// The counts that only the hub can know.
    pub(super) tally: Tally,
}
