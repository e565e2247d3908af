//! Flow control for LINK frames: a node is sent no more than a limit beyond what its socket has
//! taken (SM2-LNK-006), and no more than it has room for (SM2-LNK-007).
//!
//! Other nodes decide how many links a node gets, so they could otherwise fill its queue at the Manager. A link is
//! recorded at once, and its two LINK frames are sent together, as soon as both nodes have room. The Manager observes
//! the sockets: a node need not acknowledge anything, and a node that reads is never delayed. The number of MAX_LINKS
//! is a total, as in QUIC's MAX_STREAMS. The Manager compares it with the ends that the node knows, so frames that
//! cross on the way cannot make the sum exceed it. A link that waits is a link of the Manager like any other: quotas
//! bound the number of waiting links, and a policy or WITHDRAW ends them.

use super::Registry;
use crate::{
    EntityId, LinkId, NodeId, Violation,
    manager::{
        links::{Agreed, Pair},
        node_record::{Farewells, NodeRecord},
    },
};

impl Registry {
    /// Whether a session's socket has as many LINKs ahead of it as a node may have.
    pub(in crate::manager) fn is_full(&self, node: NodeId) -> bool {
        let record = self.sessions.record(node);
        record.is_some_and(|it| self.has_full_socket(it))
    }

    const fn has_full_socket(&self, record: &NodeRecord) -> bool {
        record.links_in_flight >= self.limits.links_in_flight()
    }

    /// Whether the Manager holds back a link with this many ends at a session.
    pub(in crate::manager) fn holds_back(&self, node: NodeId, ends: usize) -> bool {
        let record = self.sessions.record(node);
        record.is_some_and(|it| self.has_full_socket(it) || it.lacks_room_for(ends))
    }

    /// Whether one of the two sessions has no room for a link of this pair.
    //= SM2-LNK-006, SM2-LNK-007
    fn lacks_room(&self, pair: Pair) -> bool {
        pair.nodes().any(|it| self.holds_back(it, pair.ends_at(it)))
    }

    /// Whether some link of this session may wait for ends of other links to end.
    pub(super) fn is_short_of_ends(&self, node: NodeId) -> bool {
        // A link of the session with itself has two ends there.
        let record = self.sessions.record(node);
        record.is_some_and(|it| it.lacks_room_for(2))
    }

    /// The session's socket has taken all that was sent to it.
    //= SM2-LNK-006
    pub(in crate::manager) fn drained(&mut self, node: NodeId) {
        if let Some(record) = self.sessions.record_mut(node) {
            record.links_in_flight = 0;
            self.pending_links.has_room(node);
        }
    }

    /// MAX_LINKS: links may wait for the room that the node states.
    //= SM2-LNK-007
    pub(in crate::manager) fn set_max_links(&mut self, node: NodeId, max_links: u32) {
        let record = self.sessions.record_mut(node);
        if record.is_some_and(|it| it.set_max_links(max_links)) {
            self.node_changed(node);
            self.pending_links.has_room(node);
        }
    }

    /// UNLINKED: a node says farewell to its end of a link.
    //= SM2-LNK-003, SM2-LNK-007
    pub(in crate::manager) fn farewell(
        &mut self,
        EntityId { node, interface }: EntityId,
        link: LinkId,
    ) -> Result<Farewells, Violation> {
        let was_short = self.is_short_of_ends(node);
        let record = self.sessions.record_mut(node);
        let record = record.ok_or(violation!(UnknownInterface, "SM2-LNK-003"))?;
        if self.pending_links.contains(node, link) && record.has_link(interface, link) == Some(true)
        {
            // The node was not told of this link, so it can only have guessed the number.
            return Err(violation!(UnknownLink, "SM2-LNK-003"));
        }
        let farewells = record.farewell(interface, link)?;
        if was_short {
            self.pending_links.has_room(node);
        }
        Ok(farewells)
    }

    /// Takes back the two LINKs of a link: the driver did not send them.
    pub(super) fn not_sent(&mut self, pair: Pair) {
        for EntityId { node, interface } in pair.entities() {
            if let Some(record) = self.sessions.record_mut(node) {
                record.not_announced(interface);
                self.pending_links.has_room(node);
            }
        }
    }

    /// Whether the LINKs of a new link have to wait: one of the two sessions has no room, or older
    /// links of the session are pending and about to be announced.
    //= SM2-LNK-006, SM2-LNK-007
    pub(in crate::manager) fn must_wait(&self, pair: Pair) -> bool {
        let is_announceable = |it| self.pending_links.is_announceable(it);
        self.lacks_room(pair) || pair.nodes().any(is_announceable)
    }

    /// The LINKs of a pending link are sent, if both ends have room now. Returns the pair and what
    /// it agreed on.
    //= SM2-LNK-006
    pub(in crate::manager) fn announce(&mut self, link: LinkId) -> Option<(Pair, Agreed)> {
        let (pair, agreed) = self.links.made_as(link)?;
        if !self.sessions.are_there(pair) || self.lacks_room(pair) {
            return None;
        }
        self.pending_links.remove(pair, link);
        for EntityId { node, interface } in pair.entities() {
            if let Some(record) = self.sessions.record_mut(node) {
                record.announce(interface);
            }
        }
        self.link_changed(link, pair);
        Some((pair, agreed))
    }

    /// Whether every pending link waits for room or a turn at one of its ends, or to be ended.
    pub(super) fn flow_control_agrees(&self) -> bool {
        let may_come = |it: NodeId| self.pending_links.is_announceable(it);
        let sound = |(node, link): (NodeId, LinkId)| {
            let pair = self.links.made(link);
            pair.is_some_and(|pair| {
                let waits = self.lacks_room(pair)
                    || pair.nodes().any(may_come)
                    || !self.sessions.are_there(pair);
                let mut all = pair.nodes();
                waits
                    && pair.ends_at(node) > 0
                    && all.all(|it| self.pending_links.contains(it, link))
            })
        };
        let is_there = |it: NodeId| self.sessions.get(it).is_some();
        self.pending_links.iter().all(sound) && self.pending_links.announceable().all(is_there)
    }
}
