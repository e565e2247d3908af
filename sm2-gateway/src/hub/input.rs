//! The inputs of a hub.

use sm2_proto::gateway::{GatewayId, OfferId, Subject, session::Initiator};

use super::{domain::LocalEvent, policy::Policy};
use crate::peer::{ConnectionId, Event};

/// An input of a hub.
#[derive(Clone, Debug)]
pub enum Input {
    /// An event of a connection.
    Peer {
        /// The connection.
        connection: ConnectionId,
        /// The side that opened it.
        initiator: Initiator,
        /// The event.
        event: Event,
    },
    /// An event of the domain.
    Local(LocalEvent),
    /// Replaces the rules.
    Policy(Policy),
    /// Time has passed: the next part of the routes follows the rules and connections.
    Tick,
    /// A message that the hub has put out was lost, since a queue was full. Legal while outputs
    /// wait.
    NoRoom(NoRoom),
    /// A peer is no longer trusted.
    Distrust(GatewayId),
}

/// A message that a queue behind the hub had no room for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NoRoom {
    /// A [`Command::Message`](crate::peer::Command::Message).
    ForPeer {
        /// The connection.
        connection: ConnectionId,
        /// The offer of its topic.
        offer: OfferId,
    },
    /// A [`LocalCommand::Publish`](super::LocalCommand::Publish).
    ForDomain {
        /// Its topic.
        subject: Subject,
        /// The gateway of the domain where it was published.
        origin: GatewayId,
    },
}
