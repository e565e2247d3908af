//! The connections of a router: the open ones, and those that have ended and have offers left.

use alloc::collections::{BTreeMap, BTreeSet};

use super::super::{GatewayId, OfferId};

/// One connection with a peer. Its number tells it from the others with that peer: a peer can connect again
/// before the router has removed the offers of its last connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) struct Connection {
    pub(super) peer: GatewayId,
    number: u64,
}

/// The connections of a router.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Connections {
    /// The open connection of each peer, with the number of the last offer to the peer.
    open: BTreeMap<GatewayId, (Connection, OfferId)>,
    /// The connections that have ended, and whose offers are not removed yet.
    ended: BTreeSet<Connection>,
}

impl Connections {
    /// Opens a connection with a peer, and ends the one before.
    pub(super) fn open(&mut self, peer: GatewayId) {
        self.end(peer);
        let ended = Connection { peer, number: 0 }..=Connection {
            peer,
            number: u64::MAX,
        };
        let last = self.ended.range(ended).next_back();
        let number = last.map_or(0, |it| it.number + 1);
        let connection = Connection { peer, number };
        self.open.insert(peer, (connection, OfferId(0)));
    }

    /// Ends the connection with a peer. False if there is none.
    pub(super) fn end(&mut self, peer: GatewayId) -> bool {
        let ended = self.open.remove(&peer);
        self.ended.extend(ended.map(|(connection, _)| connection));
        ended.is_some()
    }

    /// One of the connections that have ended.
    pub(super) fn first_ended(&self) -> Option<Connection> {
        self.ended.first().copied()
    }

    /// Nothing is left of a connection that has ended.
    pub(super) fn forget(&mut self, ended: Connection) {
        self.ended.remove(&ended);
    }

    /// The open connection with a peer.
    pub(super) fn with(&self, peer: GatewayId) -> Option<Connection> {
        self.open.get(&peer).map(|(connection, _)| *connection)
    }

    pub(super) fn is_open(&self, connection: &Connection) -> bool {
        self.with(connection.peer) == Some(*connection)
    }

    /// The open connections, each with the number of the last offer to the peer.
    pub(super) fn iter_mut(&mut self) -> impl Iterator<Item = (Connection, &mut OfferId)> {
        self.open
            .values_mut()
            .map(|(connection, last)| (*connection, last))
    }

    /// The number of open connections.
    pub(super) fn len(&self) -> usize {
        self.open.len()
    }
}
