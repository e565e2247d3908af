//! The busy sessions. The one that has used least of the Manager's work goes next.
//!
//! Start-time fair queueing over the units of [`budget`](super::budget). The *tag* of a session grows by the units that
//! its work has cost. The session with the smallest tag goes next, and the virtual time is the greatest tag of a
//! session that went. A tag is never further behind the virtual time than the *credit*: a session that has used little
//! can do work of that many units before all sessions that use their share or more, and gains nothing from having been
//! quiet for longer. Among sessions without credit, each gets the same number of units.
//!
//! With turns alone, a DECLARE with 80 matches beside fifty busy sessions would wait fifty parts for each of its own.

use alloc::collections::{BTreeMap, BTreeSet};

use crate::NodeId;

/// The credit of a quiet session, in parts of the budget.
pub(super) const CREDIT_PARTS: u64 = 32;

/// The sessions that wait to be served, each at most once.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct FairQueue {
    /// The credit in units.
    credit: u64,
    /// The sessions that wait, by their tags.
    order: BTreeSet<(u64, NodeId)>,
    /// The tag of each session that has been charged, and of each one that waits.
    tags: BTreeMap<NodeId, u64>,
    /// The virtual time.
    virtual_units: u64,
}

impl FairQueue {
    /// An empty queue of sessions whose parts cost this many units.
    pub(super) const fn new(part_units: usize) -> Self {
        Self {
            credit: (part_units as u64).saturating_mul(CREDIT_PARTS),
            order: BTreeSet::new(),
            tags: BTreeMap::new(),
            virtual_units: 0,
        }
    }

    pub(super) fn insert(&mut self, node: NodeId) {
        let tag = self.tag(node);
        if !self.contains(node) {
            self.tags.insert(node, tag);
            self.order.insert((tag, node));
        }
    }

    pub(super) fn remove(&mut self, node: NodeId) {
        if let Some(&tag) = self.tags.get(&node) {
            self.order.remove(&(tag, node));
        }
        // If no session waits, none has to go before another. So machines that differ only in their past are equal.
        if self.order.is_empty() {
            self.tags.clear();
            self.virtual_units = 0;
        }
    }

    /// The session is over, and has no work left.
    pub(super) fn forget(&mut self, node: NodeId) {
        self.remove(node);
        self.tags.remove(&node);
    }

    /// Notes the cost of work of a session.
    pub(super) fn charge(&mut self, node: NodeId, units: usize) {
        if self.order.is_empty() || units == 0 {
            return;
        }
        let next = self.tag(node).saturating_add(units as u64);
        if let Some(tag) = self.tags.insert(node, next)
            && self.order.remove(&(tag, node))
        {
            self.order.insert((next, node));
        }
    }

    pub(super) fn contains(&self, node: NodeId) -> bool {
        let tag = self.tags.get(&node);
        tag.is_some_and(|&tag| self.order.contains(&(tag, node)))
    }

    pub(super) fn is_empty(&self) -> bool {
        self.order.is_empty()
    }

    /// All sessions that wait.
    pub(super) fn iter(&self) -> impl Iterator<Item = NodeId> {
        self.order.iter().map(|&(_, node)| node)
    }

    /// The session that goes next. It stays in the queue.
    pub(super) fn next(&mut self) -> Option<NodeId> {
        let &(tag, node) = self.order.first()?;
        self.virtual_units = self.virtual_units.max(tag);
        Some(node)
    }

    fn tag(&self, node: NodeId) -> u64 {
        let least = self.virtual_units.saturating_sub(self.credit);
        self.tags.get(&node).map_or(least, |&tag| tag.max(least))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use alloc::vec::Vec;

    const PART: usize = 10;

    fn queue(sessions: impl Iterator<Item = u64>) -> FairQueue {
        let mut queue = FairQueue::new(PART);
        sessions.for_each(|it| queue.insert(NodeId(it)));
        queue
    }

    /// The sessions that go in the next turns. `cost` is the cost of a turn.
    fn turns(queue: &mut FairQueue, count: usize, cost: impl Fn(u64) -> usize) -> Vec<u64> {
        let turn = |_| {
            let node = queue.next().unwrap();
            queue.charge(node, cost(node.0));
            node.0
        };
        (0..count).map(turn).collect()
    }

    fn times(turns: &[u64], node: u64) -> usize {
        turns.iter().filter(|&&it| it == node).count()
    }

    #[test]
    fn busy_sessions_get_the_same_number_of_units() {
        let mut queue = queue(1..=3);
        let cost = |node| if node == 2 { PART / 2 } else { PART };
        let all = turns(&mut queue, 400, cost);
        assert_eq!([1, 2, 3].map(|it| times(&all, it)), [100, 200, 100]);
    }

    #[test]
    fn a_quiet_session_has_credit_and_not_more() {
        let mut queue = queue(1..=50);
        turns(&mut queue, 50 * 100, |_| PART);
        queue.insert(NodeId(99));
        let all = turns(&mut queue, 200, |_| PART);
        let credit = CREDIT_PARTS as usize;
        // The other sessions may be one part apart.
        assert!(all[..credit - 1].iter().all(|&it| it == 99), "{all:?}");
        assert!(times(&all, 99) <= credit + 200 / 50 + 1, "{all:?}");
        // Without credit, it waits as long as all others.
        let later = turns(&mut queue, 51 * 4, |_| PART);
        assert!((3..=5).contains(&times(&later, 99)), "{later:?}");
    }

    #[test]
    fn credit_comes_back_with_the_time_that_a_session_leaves_to_others() {
        let mut queue = queue(1..=2);
        turns(&mut queue, 200, |_| PART);
        // It has used its credit and eight parts more.
        let credit = CREDIT_PARTS as usize;
        queue.charge(NodeId(9), (credit + 8) * PART);
        queue.insert(NodeId(9));
        assert_eq!(times(&turns(&mut queue, 2 * 7, |_| PART), 9), 0);
        queue.remove(NodeId(9));
        // The others have sixteen parts each, half of the credit.
        turns(&mut queue, 2 * (8 + 16) - 14, |_| PART);
        queue.insert(NodeId(9));
        let all = turns(&mut queue, credit, |_| PART);
        assert!(
            (14..=18).contains(&all.iter().take_while(|&&it| it == 9).count()),
            "{all:?}"
        );
    }

    #[test]
    fn an_empty_queue_remembers_nothing() {
        let mut used = queue(1..=3);
        turns(&mut used, 20, |_| PART);
        (1..=3).for_each(|it| used.remove(NodeId(it)));
        assert_eq!(used, FairQueue::new(PART));
        assert_eq!(used.next(), None);
        used.charge(NodeId(1), PART);
        assert_eq!(used, FairQueue::new(PART));
        // A session that is over leaves nothing, while others wait.
        let mut with = queue(1..=2);
        with.charge(NodeId(2), PART);
        with.forget(NodeId(2));
        assert_eq!(with, queue(1..=1));
    }
}
