//! What a program is told of its links.

use std::sync::Arc;

use sm2_proto::LinkId;
use sm2_proto::control::Peer;
use sm2_proto::link::{Counters, Delivery, End, LaneKind};

use super::interface::Interface;
use super::link::LinkDriver;

/// One link of an interface, now or in the past.
#[derive(Clone, Debug)]
pub struct LinkStatus {
    /// Its id.
    pub id: LinkId,
    /// The interface at its other end: node, name, contract.
    pub peer: Arc<Peer>,
    /// Whether both sides have opened it.
    pub open: bool,
    /// Whether nothing on it may be displaced.
    pub reliable: bool,
    /// Whether every message on it is inline or sealed.
    pub sealed: bool,
    /// Whether its messages go through a ring in shared memory, not through its socket.
    pub ring: bool,
    /// What became of the messages that this side sent on it (SM2-QOS-004).
    pub counters: Counters,
    /// What came from the other side.
    pub received: Received,
    /// Why it is over, if it is.
    pub end: Option<End>,
}

/// What one side of a link received.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Received {
    /// Messages, requests or replies that the program took.
    pub messages: u64,
    /// Their length in bytes, together.
    pub bytes: u64,
    /// Messages that were lost before those that were taken.
    pub lost: u64,
}

impl Received {
    pub(super) const fn add(&mut self, delivery: &Delivery) {
        self.messages += 1;
        self.bytes = self.bytes.wrapping_add(delivery.len);
        self.lost += delivery.lost;
    }
}

impl LinkStatus {
    pub(super) fn of(link: &LinkDriver) -> Self {
        Self {
            id: link.id,
            peer: Arc::clone(&link.peer),
            open: link.is_open(),
            reliable: link.is_reliable(),
            sealed: link.is_sealed(),
            ring: link.machine.lane() == LaneKind::Ring,
            counters: link.counters(),
            received: link.received,
            end: link.end(),
        }
    }

    pub(super) fn add_to(&self, sum: &mut Counters) {
        add(sum, &self.counters);
    }
}

/// Adds `more` to `sum`.
fn add(sum: &mut Counters, more: &Counters) {
    sum.offered += more.offered;
    sum.delivered += more.delivered;
    sum.overwritten += more.overwritten;
    sum.discarded += more.discarded;
    sum.deadline += more.deadline;
    sum.closed += more.closed;
    sum.in_flight += more.in_flight;
}

impl Interface {
    // ---- accounts ----

    /// All links, those that ended first.
    pub(crate) fn statuses(&self) -> Vec<LinkStatus> {
        let live = self.links().filter(|link| !link.buried).map(LinkStatus::of);
        self.ended.iter().cloned().chain(live).collect()
    }

    /// The sum over all links that ever were.
    //= SM2-QOS-004
    pub(crate) fn counters(&self) -> Counters {
        let mut sum = self.ended_sum;
        for link in self.links().filter(|link| !link.buried) {
            add(&mut sum, &link.counters());
        }
        sum
    }
}
