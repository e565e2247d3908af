//! The state of a link whose messages are sent over the socket.

use super::{Config, inbound::Inbound, outbound::Outbound};
use crate::Violation;

/// The messages of both directions.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct SocketLane {
    pub(super) outbound: Outbound,
    pub(super) inbound: Inbound,
    /// The window of the RING that the other end still sends, because it offers the ring lane and this end does not.
    pub(super) unused_ring: Option<u32>,
}

impl SocketLane {
    pub(super) fn new(config: &Config) -> Self {
        Self {
            outbound: Outbound::new(config),
            inbound: Inbound::new(config),
            unused_ring: None,
        }
    }

    /// Handles a RING whose ring this end does not use.
    //= SM2-RNG-002
    pub(super) fn on_ring(&mut self, window: u32) -> Result<(), Violation> {
        match self.unused_ring.take() {
            Some(expected) if expected == window => Ok(()),
            _ => Err(violation!(BadRing, "SM2-RNG-002")),
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
