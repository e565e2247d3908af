//! Flow control for LINK frames: a node is sent no more than a limit beyond what its socket has
//! taken (SM2-LNK-006), and no more than it has room for (SM2-LNK-007).
//!
//! Other nodes decide how many links a node gets, so they could otherwise fill its queue at the Manager. A link is
//! recorded at once, and its two LINK frames are sent together, as soon as both nodes have room. The Manager observes
//! the sockets: a node need not acknowledge anything, and a node that reads is never delayed. The number of MAX_LINKS
//! is a total, as in QUIC's MAX_STREAMS. The Manager compares it with the ends that the node knows, so frames that
//! cross on the way cannot make the sum exceed it. A link that waits is a link of the Manager like any other: quotas
//! bound the number of waiting links, and a policy or WITHDRAW ends them.

use super::{
    Manager,
    budget::{Budget, LINK, PAIR},
    links::Pair,
    node_record::NodeRecord,
    session::Session,
};
use crate::{EntityId, LinkId, NodeId, control::Key};

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

    //= SM2-LNK-006
    pub(super) fn drained(&mut self, node: NodeId) {
        let record = self.sessions.get_mut(&node).and_then(Session::node_mut);
        if let Some(record) = record {
            record.links_in_flight = 0;
            self.pending_links.has_room(node);
        }
    }

    /// Takes back the two LINKs of a link: the driver did not send them.
    pub(super) fn not_sent(&mut self, pair: Pair) {
        for EntityId { node, interface } in pair.entities() {
            let record = self.sessions.get_mut(&node).and_then(Session::node_mut);
            if let Some(record) = record {
                record.not_announced(interface);
                self.pending_links.has_room(node);
            }
        }
    }

    /// MAX_LINKS: links may wait for the room that the node states.
    //= SM2-LNK-007
    pub(super) fn set_max_links(&mut self, node: NodeId, max_links: u32) {
        let record = self.sessions.get_mut(&node).and_then(Session::node_mut);
        if record.is_some_and(|it| it.set_max_links(max_links)) {
            self.node_changed(node);
            self.pending_links.has_room(node);
        }
    }

    /// Whether some link of this session may wait for ends of other links to end.
    pub(super) fn is_short_of_ends(&self, node: NodeId) -> bool {
        // A link of the session with itself has two ends there.
        let record = self.sessions.get(&node).and_then(Session::node);
        record.is_some_and(|it| it.lacks_room_for(2))
    }

    /// Whether one of the two sessions has no room for a link of this pair.
    //= SM2-LNK-006, SM2-LNK-007
    fn lacks_room(&self, pair: Pair) -> bool {
        pair.nodes().any(|node| {
            let ends = pair.entities().iter().filter(|it| it.node == node).count();
            self.holds_back(node, ends)
        })
    }

    /// Whether the Manager holds back a link with this many ends at a session.
    fn holds_back(&self, node: NodeId, ends: usize) -> bool {
        let record = self.sessions.get(&node).and_then(Session::node);
        record.is_some_and(|it| self.is_full(it) || it.lacks_room_for(ends))
    }

    const fn is_full(&self, record: &NodeRecord) -> bool {
        record.links_in_flight >= self.limits.links_in_flight()
    }

    /// Whether the LINKs of a new link have to wait: one of the two sessions has no room, or older
    /// links of the session are pending and about to be announced.
    //= SM2-LNK-006, SM2-LNK-007
    pub(super) fn must_wait(&self, pair: Pair) -> bool {
        let is_announceable = |it| self.pending_links.is_announceable(it);
        self.lacks_room(pair) || pair.nodes().any(is_announceable)
    }

    /// Announces the pending links of a session after this one, as far as both ends have room and
    /// the budget of one part allows.
    //= SM2-LNK-006, SM2-SES-009
    pub(super) fn announce_pending(&mut self, node: NodeId, mut after: LinkId) {
        let mut budget = Budget::new(&self.limits);
        while !self.holds_back(node, 1)
            && let Some(link) = self.pending_links.next_of(node, after)
        {
            if budget.is_spent() {
                return self.pending_links.go_on(node, after);
            }
            after = link;
            budget.spend(PAIR);
            if let Some((pair, agreed)) = self.links.made_as(link)
                && self.is_there(pair)
                && !self.lacks_room(pair)
            {
                budget.spend(LINK);
                self.pending_links.remove(pair, link);
                for EntityId { node, interface } in pair.entities() {
                    let record = self.sessions.get_mut(&node).and_then(Session::node_mut);
                    if let Some(record) = record {
                        record.announce(interface);
                    }
                }
                let offering = pair.offering;
                self.changed(Key::Link { link, offering });
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
        let may_come = |it: NodeId| self.pending_links.is_announceable(it);
        let sound = |(node, link): (NodeId, LinkId)| {
            let pair = self.links.made(link);
            pair.is_some_and(|pair| {
                let mut nodes = pair.nodes();
                let mut all = pair.nodes();
                nodes.any(|it| it == node)
                    && all.all(|it| self.pending_links.contains(it, link))
                    && (self.lacks_room(pair) || pair.nodes().any(may_come) || !self.is_there(pair))
            })
        };
        let is_there = |it: NodeId| self.sessions.contains_key(&it);
        self.pending_links.iter().all(sound) && self.pending_links.announceable().all(is_there)
    }
}
