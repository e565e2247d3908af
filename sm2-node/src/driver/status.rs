//! The reports of links for a program.

use std::sync::Arc;

use sm2_proto::LinkId;
use sm2_proto::control::LinkPeer;
use sm2_proto::link::{Counters, End};

use super::interface::Header;

/// The status of one link of an interface, current or past.
#[derive(Clone, Debug)]
pub struct LinkStatus {
    /// The id of the link.
    pub id: LinkId,
    /// The interface at the other end: node, name, contract.
    pub peer: Arc<LinkPeer>,
    /// Whether both sides have opened the link.
    pub open: bool,
    /// Whether no message on the link may be displaced.
    pub reliable: bool,
    /// Whether every message on the link is inline or sealed.
    pub sealed: bool,
    /// Whether messages go through a ring in shared memory instead of the socket.
    pub ring: bool,
    /// Whether the kernel had no memory when the node last used the link's socket. The link goes on as soon as
    /// there is memory (SM2-TRN-013).
    pub short_of_memory: bool,
    /// Counts of the messages that this side sent on the link, by outcome (SM2-QOS-006).
    pub counters: Counters,
    /// Counts of the messages from the other side.
    pub received: Received,
    /// How many periods of the deadline that this subscriber demands have passed without a message (SM2-QOS-009).
    pub missed_deadlines: u64,
    /// Whether the publisher at the other end is alive (SM2-QOS-011). Always true for a subscriber that demands no
    /// liveliness, and at all other interfaces.
    pub alive: bool,
    /// How often the publisher at the other end stopped being alive.
    pub lost_liveliness: u64,
    /// The reason why the link is over, if it is.
    pub end: Option<End>,
}

/// Counts of the messages that one side of a link received.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Received {
    /// Messages, requests or replies that the program took.
    pub messages: u64,
    /// The sum of their lengths, in bytes.
    pub bytes: u64,
    /// Messages that were lost on the link before the messages that the program took.
    pub lost: u64,
    /// Messages that later ones displaced on this side before the program took them (SM2-QOS-001). In a ring, the
    /// publisher displaces them, and counts them alone.
    pub discarded: u64,
    /// Messages that were published while the publisher had no link with this subscriber, before this link
    /// (SM2-QOS-013). They are not in `lost`.
    pub away: u64,
    /// Messages that were older than their lifespan when the program would have taken them (SM2-QOS-010).
    pub expired: u64,
}

impl Received {
    pub(super) const fn add(&mut self, header: &Header) {
        self.messages += 1;
        self.bytes = self.bytes.wrapping_add(header.len);
        self.lost = self.lost.saturating_add(header.lost);
    }
}
