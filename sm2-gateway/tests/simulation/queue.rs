//! Queues between the tasks of a gateway. Each item is taken a little later, in order.

use std::collections::VecDeque;

use sm2_proto::Instant;

use super::{network::MS, random::Random};

/// Items from one task to another, with the time when each can be taken.
pub(crate) struct Queue<T>(VecDeque<(Instant, T)>);

impl<T> Queue<T> {
    pub(crate) const fn new() -> Self {
        Self(VecDeque::new())
    }

    pub(crate) fn push(&mut self, now: Instant, late: u64, item: T) {
        let last = self.0.back().map_or(now, |(at, _)| *at);
        self.0.push_back((last.max(Instant(now.0 + late)), item));
    }

    pub(crate) fn next_at(&self) -> Option<Instant> {
        self.0.front().map(|(at, _)| *at)
    }

    pub(crate) fn pop(&mut self, now: Instant) -> Option<T> {
        let is_due = self.next_at()? <= now;
        is_due.then(|| self.0.pop_front())?.map(|(_, item)| item)
    }

    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }
}

/// Returns a random delay until another task takes an item.
pub(crate) const fn lag(random: &mut Random) -> u64 {
    match random.percent(70) {
        true => 0,
        false => random.below(3) * MS,
    }
}
