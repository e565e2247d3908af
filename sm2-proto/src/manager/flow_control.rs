//! Flow control for LINK frames: a node is sent no more than a limit beyond what its socket has
//! taken (SM2-LNK-007). Work that takes long is done in parts, in turn with all other sessions.

use super::{Manager, links::Pair, node_record::NodeRecord, session::Session};
use crate::{EntityId, LinkId, NodeId};

impl Manager {
    /// Whether the Manager holds back LINKs until a session's socket has taken all that was sent to
    /// it. The driver reports that with [`Input::Drained`](super::Input::Drained).
    #[must_use]
    pub fn awaits_room(&self, node: NodeId) -> bool {
        self.sessions
            .get(&node)
            .and_then(Session::node)
            .is_some_and(|it| self.is_full(it))
    }

    //= SM2-LNK-007
    pub(super) fn drained(&mut self, node: NodeId) {
        let record = self.sessions.get_mut(&node).and_then(Session::node_mut);
        if let Some(record) = record {
            record.links_in_flight = 0;
            self.pending_links.has_room(node);
        }
    }

    /// Takes back the two LINKs of a link: the driver did not send them.
    pub(super) fn not_sent(&mut self, pair: Pair) {
        for EntityId { node, .. } in pair.entities() {
            let record = self.sessions.get_mut(&node).and_then(Session::node_mut);
            if let Some(record) = record {
                record.links_in_flight = record.links_in_flight.saturating_sub(1);
                self.pending_links.has_room(node);
            }
        }
    }

    const fn is_full(&self, record: &NodeRecord) -> bool {
        record.links_in_flight >= self.policy.links_in_flight()
    }

    /// Whether the LINK of a new link has to wait: the session's limit is reached, or older links
    /// of the session are pending and about to be announced.
    //= SM2-LNK-007
    pub(super) fn must_wait(&self, node: NodeId, record: &NodeRecord) -> bool {
        self.is_full(record) || self.pending_links.is_ready(node)
    }

    /// Does one part of the deferred work: the pending links of one session, which its quota of
    /// links bounds, and `pairs_per_turn` pairs of one session that settles.
    pub(super) fn run_deferred(&mut self) {
        if let Some(node) = self.pending_links.next_ready() {
            self.announce_pending(node);
        }
        if let Some(node) = self.settling.next() {
            self.settle(node);
        }
    }

    /// Whether deferred work can be done now.
    pub(super) fn has_deferred(&self) -> bool {
        self.pending_links.has_ready() || !self.settling.is_empty()
    }

    /// Announces the pending links of a session, as far as both ends have room.
    //= SM2-LNK-007
    fn announce_pending(&mut self, node: NodeId) {
        let mut after = LinkId::FIRST;
        while !self.awaits_room(node)
            && let Some(link) = self.pending_links.next_of(node, after)
        {
            after = link;
            if let Some((pair, agreed)) = self.links.made_as(link)
                && !pair.nodes().any(|it| self.awaits_room(it))
            {
                self.pending_links.remove(pair, link);
                for EntityId { node, .. } in pair.entities() {
                    let record = self.sessions.get_mut(&node).and_then(Session::node_mut);
                    if let Some(record) = record {
                        record.links_in_flight += 1;
                    }
                }
                let key = self.links.key(link);
                self.announce((link, key), pair.entities(), agreed);
            }
        }
    }

    /// Checks `pairs_per_turn` pairs of a session after its CLAIMED, and links those that match
    /// and have no link. The session waits for its next turn if pairs are left.
    //= SM2-RES-007
    pub(super) fn settle(&mut self, node: NodeId) {
        let mut left = self.policy.pairs_per_turn.max(1);
        while let Some(entity) = self.unsettled(node) {
            if left == 0 {
                self.settling.insert(node);
                return;
            }
            left -= self.link_missing(entity, left);
        }
    }

    fn unsettled(&mut self, node: NodeId) -> Option<(EntityId, EntityId)> {
        self.sessions.get_mut(&node)?.unsettled(node)
    }

    /// Whether every pending link waits for room or a turn at one of its ends, and every session
    /// that settles waits for its turn.
    pub(super) fn flow_control_agrees(&self) -> bool {
        let waits = |it: NodeId| self.awaits_room(it) || self.pending_links.is_ready(it);
        let sound = |(node, link): (NodeId, LinkId)| {
            let pair = self.links.made(link);
            pair.is_some_and(|pair| {
                let mut nodes = pair.nodes();
                let mut all = pair.nodes();
                nodes.any(|it| it == node)
                    && all.all(|it| self.pending_links.contains(it, link))
                    && pair.nodes().any(waits)
            })
        };
        let is_there = |it: NodeId| self.sessions.contains_key(&it);
        let settling = self.sessions.iter().filter(|(_, it)| it.is_settling());
        self.pending_links.iter().all(sound)
            && self.pending_links.ready().all(is_there)
            && settling.map(|(&node, _)| node).eq(self.settling.iter())
    }

    /// A session is over: it waits for no turn. Its links end one by one.
    pub(super) fn forget_deferred(&mut self, node: NodeId) {
        self.pending_links.forget_session(node);
        self.settling.remove(node);
    }
}
