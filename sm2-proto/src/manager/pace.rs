//! LINKs in measure: nobody is sent more than so many beyond what its socket takes
//! (SM2-LNK-007), and what takes long is done in turns with all others.

use alloc::collections::BTreeSet;
use core::ops::Bound;

use super::{Manager, links::Pair, node_record::NodeRecord, session::Session};
use crate::{EntityId, LinkId, NodeId};

/// Which links wait for their LINKs, and for whom.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Pace {
    /// The links that nobody was told of yet, the oldest first, by the session of each end.
    owed: BTreeSet<(NodeId, LinkId)>,
    /// Who has room again, and links that wait.
    roomy: Turns,
}

/// Sessions that are served one at a time, each in its turn.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Turns {
    waiting: BTreeSet<NodeId>,
    /// Who was served last, as long as others wait.
    last: NodeId,
}

impl Manager {
    /// Whether the Manager holds back LINKs until it knows that a session's socket has taken all
    /// that was sent to it: then feed [`Input::Drained`](super::Input::Drained).
    #[must_use]
    pub fn awaits_room(&self, session: NodeId) -> bool {
        self.sessions
            .get(&session)
            .and_then(Session::node)
            .is_some_and(|it| self.is_full(it))
    }

    //= SM2-LNK-007
    pub(super) fn drained(&mut self, session: NodeId) {
        let record = self.sessions.get_mut(&session).and_then(Session::node_mut);
        if let Some(record) = record {
            record.links_ahead = 0;
            self.pace.invite(session);
        }
    }

    /// Both LINKs of a link were not sent after all.
    pub(super) fn not_sent(&mut self, pair: Pair) {
        for EntityId { node, .. } in pair.entities() {
            let record = self.sessions.get_mut(&node).and_then(Session::node_mut);
            if let Some(record) = record {
                record.links_ahead = record.links_ahead.saturating_sub(1);
                self.pace.invite(node);
            }
        }
    }

    const fn is_full(&self, record: &NodeRecord) -> bool {
        record.links_ahead >= self.policy.links_ahead()
    }

    /// Whether the LINK of a new link has to wait: the session has enough of them, or older ones
    /// to be told of first.
    //= SM2-LNK-007
    pub(super) fn must_wait(&self, node: NodeId, record: &NodeRecord) -> bool {
        self.is_full(record) || self.pace.roomy.contains(node)
    }

    /// A part of what was put off: one session's links that waited, which its quota of links
    /// bounds, and so many pairs of one that settles.
    pub(super) fn go_on(&mut self) {
        if let Some(session) = self.pace.roomy.next() {
            self.announce_owed(session);
        }
        if let Some(session) = self.settling.next() {
            self.settle(session);
        }
    }

    /// Whether anything was put off that can be done now.
    pub(super) fn has_work(&self) -> bool {
        !self.pace.roomy.is_empty() || !self.settling.is_empty()
    }

    /// Tells of the links of a session that waited, as far as there is room at both ends.
    //= SM2-LNK-007
    fn announce_owed(&mut self, session: NodeId) {
        let mut after = LinkId::FIRST;
        while !self.awaits_room(session)
            && let Some(link) = self.pace.owed_after(session, after)
        {
            after = link;
            if let Some((pair, agreed)) = self.links.made_as(link)
                && !pair.nodes().any(|it| self.awaits_room(it))
            {
                self.pace.cancel(pair, link);
                for EntityId { node, .. } in pair.entities() {
                    let record = self.sessions.get_mut(&node).and_then(Session::node_mut);
                    if let Some(record) = record {
                        record.links_ahead += 1;
                    }
                }
                let key = self.links.key(link);
                self.announce((link, key), pair.entities(), agreed);
            }
        }
    }

    /// Looks at so many pairs of a session that has claimed all it has, and links those that
    /// are to be linked.
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

    /// Whether every link that waits does so for a reason, and every session that settles has
    /// its turn.
    pub(super) fn pace_agrees(&self) -> bool {
        let reason = |it: NodeId| self.awaits_room(it) || self.pace.roomy.contains(it);
        let sound = |&(node, link): &(NodeId, LinkId)| {
            let pair = self.links.made(link);
            pair.is_some_and(|pair| {
                let mut nodes = pair.nodes();
                nodes.any(|it| it == node)
                    && pair.nodes().all(|it| self.pace.owed.contains(&(it, link)))
                    && pair.nodes().any(reason)
            })
        };
        let there = |it: &NodeId| self.sessions.contains_key(it);
        let settling = self.sessions.iter().filter(|(_, it)| it.is_settling());
        self.pace.owed.iter().all(sound)
            && self.pace.roomy.waiting.iter().all(there)
            && settling.map(|(id, _)| id).eq(&self.settling.waiting)
    }

    /// A session is over, and with it all its links.
    pub(super) fn forget_pace(&mut self, session: NodeId) {
        self.pace.roomy.remove(session);
        self.settling.remove(session);
    }
}

impl Pace {
    pub(super) const fn new() -> Self {
        Self {
            owed: BTreeSet::new(),
            roomy: Turns::new(),
        }
    }

    /// The LINKs of a link wait.
    pub(super) fn owe(&mut self, pair: Pair, link: LinkId) {
        self.owed.extend(pair.nodes().map(|it| (it, link)));
    }

    /// The LINKs of a link do not wait any more. Whether they did.
    pub(super) fn cancel(&mut self, pair: Pair, link: LinkId) -> bool {
        let removed = pair.nodes().map(|it| self.owed.remove(&(it, link)));
        removed.fold(false, |any, one| any | one)
    }

    /// Whether a session was not told yet of a link of its own.
    pub(super) fn owes(&self, node: NodeId, link: LinkId) -> bool {
        self.owed.contains(&(node, link))
    }

    fn owed_after(&self, node: NodeId, after: LinkId) -> Option<LinkId> {
        let rest = (Bound::Excluded((node, after)), Bound::Unbounded);
        let &(owner, link) = self.owed.range(rest).next()?;
        (owner == node).then_some(link)
    }

    /// The session has room. If links wait for that, it gets its turn.
    fn invite(&mut self, node: NodeId) {
        if self.owed_after(node, LinkId::FIRST).is_some() {
            self.roomy.insert(node);
        }
    }
}

impl Turns {
    pub(super) const fn new() -> Self {
        Self {
            waiting: BTreeSet::new(),
            last: NodeId(0),
        }
    }

    pub(super) fn insert(&mut self, node: NodeId) {
        self.waiting.insert(node);
    }

    fn remove(&mut self, node: NodeId) {
        self.waiting.remove(&node);
        self.rest();
    }

    fn contains(&self, node: NodeId) -> bool {
        self.waiting.contains(&node)
    }

    fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    /// Whose turn it is: who comes after the last one, or the first of all.
    fn next(&mut self) -> Option<NodeId> {
        let later = (Bound::Excluded(self.last), Bound::Unbounded);
        let next = self.waiting.range(later).next().copied();
        let next = next.or_else(|| self.waiting.first().copied())?;
        self.last = next;
        self.remove(next);
        Some(next)
    }

    /// Where nobody waits, nobody was the last.
    fn rest(&mut self) {
        if self.waiting.is_empty() {
            self.last = NodeId(0);
        }
    }
}
