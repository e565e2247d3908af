//! The links of an interface that are over.

use std::collections::VecDeque;

use sm2_proto::link::Counters;

use crate::driver::limits::HISTORY;
use crate::driver::status::LinkStatus;

/// The statuses of the last links that are over, at most [`HISTORY`], and the sums over all that ever were.
#[derive(Debug, Default)]
pub(super) struct EndedLinks {
    last: VecDeque<LinkStatus>,
    counters: Counters,
    missed_deadlines: u64,
    lost_liveliness: u64,
}

impl EndedLinks {
    /// Adds a link, when its end is noticed.
    pub(super) fn push(&mut self, status: LinkStatus) {
        self.missed_deadlines += status.missed_deadlines;
        self.lost_liveliness += status.lost_liveliness;
        self.counters.add(&status.counters);
        if self.last.len() == HISTORY {
            self.last.pop_front();
        }
        self.last.push_back(status);
    }

    /// The last links, the oldest first.
    pub(super) fn last(&self) -> impl Iterator<Item = &LinkStatus> {
        self.last.iter()
    }

    pub(super) const fn counters(&self) -> Counters {
        self.counters
    }

    /// How many periods of the deadline passed without a message.
    pub(super) const fn missed_deadlines(&self) -> u64 {
        self.missed_deadlines
    }

    /// How often publishers stopped being alive.
    pub(super) const fn lost_liveliness(&self) -> u64 {
        self.lost_liveliness
    }
}
