//! The links whose LINK frames wait until both nodes have read the frames before (SM2-LNK-006).

use alloc::collections::{BTreeMap, BTreeSet};
use core::ops::Bound;

use super::{links::Pair, round_robin::RoundRobin};
use crate::{LinkId, NodeId};

/// The pending links, and the sessions that can be told of theirs now.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct PendingLinks {
    /// Each link once for each node that it joins. The links of a node stand in ascending order,
    /// so the oldest comes first.
    links: BTreeSet<(NodeId, LinkId)>,
    /// The sessions that have room and pending links.
    announceable: RoundRobin,
    /// The sessions that wait for their next turn, and the last link that was looked at.
    seen: BTreeMap<NodeId, LinkId>,
}

impl PendingLinks {
    pub(super) const fn new() -> Self {
        Self {
            links: BTreeSet::new(),
            announceable: RoundRobin::new(),
            seen: BTreeMap::new(),
        }
    }

    /// Adds a link that neither node has been told of.
    pub(super) fn insert(&mut self, pair: Pair, link: LinkId) {
        self.links.extend(pair.nodes().map(|it| (it, link)));
    }

    /// Removes a link. Returns whether it was pending.
    pub(super) fn remove(&mut self, pair: Pair, link: LinkId) -> bool {
        let removed = pair.nodes().map(|it| self.links.remove(&(it, link)));
        removed.fold(false, |any, one| any | one)
    }

    /// Whether a node has not been told of this link yet.
    pub(super) fn contains(&self, node: NodeId, link: LinkId) -> bool {
        self.links.contains(&(node, link))
    }

    /// The first pending link of a node after this one.
    pub(super) fn next_of(&self, node: NodeId, after: LinkId) -> Option<LinkId> {
        let rest = (Bound::Excluded((node, after)), Bound::Unbounded);
        let &(owner, link) = self.links.range(rest).next()?;
        (owner == node).then_some(link)
    }

    /// The session has room: if links are pending for it, it waits for its turn. All of them are
    /// looked at again.
    pub(super) fn has_room(&mut self, node: NodeId) {
        self.seen.remove(&node);
        if self.next_of(node, LinkId::FIRST).is_some() {
            self.announceable.insert(node);
        }
    }

    /// Whether a session has room and waits for its turn.
    pub(super) fn is_announceable(&self, node: NodeId) -> bool {
        self.announceable.contains(node)
    }

    /// Whether any session waits for its turn.
    pub(super) fn has_announceable(&self) -> bool {
        !self.announceable.is_empty()
    }

    /// The session whose turn it is, and the link after which to begin.
    pub(super) fn next_announceable(&mut self) -> Option<(NodeId, LinkId)> {
        let node = self.announceable.next()?;
        let after = self.seen.remove(&node).unwrap_or(LinkId::FIRST);
        Some((node, after))
    }

    /// The session waits for its next turn, which begins after this link.
    pub(super) fn go_on(&mut self, node: NodeId, after: LinkId) {
        self.announceable.insert(node);
        self.seen.insert(node, after);
    }

    /// A session is over: it waits for no turn.
    pub(super) fn forget_session(&mut self, node: NodeId) {
        self.announceable.remove(node);
        self.seen.remove(&node);
    }

    /// Every node with a pending link, and the link.
    pub(super) fn iter(&self) -> impl Iterator<Item = (NodeId, LinkId)> {
        self.links.iter().copied()
    }

    /// The sessions that wait for their turn, in ascending order.
    pub(super) fn announceable(&self) -> impl Iterator<Item = NodeId> {
        self.announceable.iter()
    }
}
