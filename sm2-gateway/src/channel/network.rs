//! The queue of the network task.

use std::{io, net::SocketAddr};

use sm2_proto::gateway::GatewayId;
use tokio::sync::mpsc;

use crate::config::PeerConfig;

/// An input of the network task.
#[derive(Debug)]
pub(crate) enum NetworkEvent {
    /// A connection has an event for the QUIC endpoint.
    Endpoint {
        handle: quinn_proto::ConnectionHandle,
        event: quinn_proto::EndpointEvent,
    },
    /// An attempt to connect failed.
    Failed {
        peer: GatewayId,
        /// True if the peer closed the connection as `stale`.
        is_stale: bool,
    },
    /// The lookup of a host name of a peer has completed.
    Resolved {
        peer: GatewayId,
        host: String,
        addresses: io::Result<Vec<SocketAddr>>,
    },
    /// The hub has accepted a connection with this peer.
    Connected { peer: GatewayId, epoch: u64 },
    /// The connection with this peer has ended.
    Lost { peer: GatewayId },
    /// Replaces the trusted peers.
    Peers(Vec<PeerConfig>),
    /// Stops dialling and accepting.
    Stop,
}

/// The sending half of the network task's queue.
#[derive(Clone, Debug)]
pub(crate) struct NetworkHandle(mpsc::UnboundedSender<NetworkEvent>);

/// The network task's queue.
pub(crate) fn channel() -> (NetworkHandle, mpsc::UnboundedReceiver<NetworkEvent>) {
    let (sender, receiver) = mpsc::unbounded_channel();
    (NetworkHandle(sender), receiver)
}

impl NetworkHandle {
    /// Queues an event. Does nothing once the network task has ended: no connection outlives it.
    pub(crate) fn send(&self, event: NetworkEvent) {
        let _ = self.0.send(event);
    }
}
