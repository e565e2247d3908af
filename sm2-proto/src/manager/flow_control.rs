//! Flow control for LINK frames: a node is sent no more than a limit beyond what its socket has
//! taken (SM2-LNK-007).

use super::{
    Manager,
    budget::{Budget, LINK, PAIR},
    links::Pair,
    node_record::NodeRecord,
    session::Session,
};
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
        self.is_full(record) || self.pending_links.is_announceable(node)
    }

    /// Announces the pending links of a session after this one, as far as both ends have room and
    /// the budget of one part allows.
    //= SM2-LNK-007, SM2-SES-009
    pub(super) fn announce_pending(&mut self, node: NodeId, mut after: LinkId) {
        let mut budget = Budget::new(&self.policy);
        while !self.awaits_room(node)
            && let Some(link) = self.pending_links.next_of(node, after)
        {
            if budget.is_spent() {
                return self.pending_links.go_on(node, after);
            }
            after = link;
            budget.spend(PAIR);
            if let Some((pair, agreed)) = self.links.made_as(link)
                && self.is_there(pair)
                && !pair.nodes().any(|it| self.awaits_room(it))
            {
                budget.spend(LINK);
                self.pending_links.remove(pair, link);
                for EntityId { node, .. } in pair.entities() {
                    let record = self.sessions.get_mut(&node).and_then(Session::node_mut);
                    if let Some(record) = record {
                        record.links_in_flight += 1;
                    }
                }
                let key = self.links.key(link);
                let links = self.announcement((link, key), pair.entities(), agreed);
                self.outputs.extend(links);
            }
        }
    }

    /// Whether both interfaces of a pair are there. Links of an interface that is gone may still
    /// have to be ended.
    pub(super) fn is_there(&self, pair: Pair) -> bool {
        let is_there = |it| self.is_granted(it);
        pair.entities().into_iter().all(is_there)
    }

    /// Whether every pending link waits for room or a turn at one of its ends, or to be ended.
    pub(super) fn flow_control_agrees(&self) -> bool {
        let waits = |it: NodeId| self.awaits_room(it) || self.pending_links.is_announceable(it);
        let sound = |(node, link): (NodeId, LinkId)| {
            let pair = self.links.made(link);
            pair.is_some_and(|pair| {
                let mut nodes = pair.nodes();
                let mut all = pair.nodes();
                nodes.any(|it| it == node)
                    && all.all(|it| self.pending_links.contains(it, link))
                    && (pair.nodes().any(waits) || !self.is_there(pair))
            })
        };
        let is_there = |it: NodeId| self.sessions.contains_key(&it);
        self.pending_links.iter().all(sound) && self.pending_links.announceable().all(is_there)
    }
}
