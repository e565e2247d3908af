//! The outputs of a hub.

use sm2_proto::{
    Name,
    gateway::{GatewayId, Subject},
};

use super::domain::LocalCommand;
use crate::peer::{Command, ConnectionId};

/// An output of a hub.
#[derive(Clone, Debug)]
pub enum Output {
    /// A command to a connection.
    Peer {
        /// The connection.
        connection: ConnectionId,
        /// The command.
        command: Command,
    },
    /// A command to the domain's side.
    Local(LocalCommand),
    /// A peer wants a topic or service of the domain, and the gateway has no room for it: its process has its share.
    Waits {
        /// The topic or service.
        subject: Subject,
    },
    /// There is a connection with this peer. Discovery stops looking for it.
    Connected {
        /// The id of the peer.
        peer: GatewayId,
        /// The epoch of its process.
        epoch: u64,
        /// Its name.
        name: Name,
    },
    /// There is no connection with this peer any more.
    Lost {
        /// The id of the peer.
        peer: GatewayId,
    },
}
