//! The state of a link whose messages are sent over the socket.

use super::{Config, inbound::Inbound, outbound::Outbound};

/// The messages of both directions.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct SocketLane {
    pub(super) outbound: Outbound,
    pub(super) inbound: Inbound,
}

impl SocketLane {
    pub(super) fn new(config: &Config) -> Self {
        Self {
            outbound: Outbound::new(config),
            inbound: Inbound::new(config),
        }
    }

    /// Ends both directions with the link. Passes the keys of all messages that were not settled to
    /// `each`.
    pub(super) fn end(&mut self, each: impl FnMut(u64)) {
        self.outbound.end(each);
        self.inbound.end();
    }

    /// Checks the invariants, which hold after each call.
    pub(super) fn invariants(&self) {
        self.outbound.invariants();
        self.inbound.invariants();
    }
}
