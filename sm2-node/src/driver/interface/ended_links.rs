//! The links of an interface that are over.

use std::collections::VecDeque;

use sm2_proto::QosWatch;
use sm2_proto::link::Counters;

use crate::driver::limits::HISTORY;
use crate::driver::link::LinkDriver;
use crate::driver::status::LinkStatus;

/// The statuses of the last links that are over, at most [`HISTORY`], and the sums over all that ever were.
#[derive(Debug, Default)]
pub(super) struct EndedLinks {
    /// The oldest first.
    pub(super) last: VecDeque<LinkStatus>,
    pub(super) counters: Counters,
    pub(super) qos: QosCounts,
}

/// How publishers have kept their deadlines and leases.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct QosCounts {
    /// How many periods have passed without a message.
    pub(crate) missed_deadlines: u64,
    /// How often a publisher stopped being alive.
    pub(crate) lost_liveliness: u64,
}

impl EndedLinks {
    /// Adds a link, when its end is noticed.
    pub(super) fn push(&mut self, link: &LinkDriver) {
        self.counters.add(&link.counters());
        self.qos.add(link.qos_watch());
        if self.last.len() == HISTORY {
            self.last.pop_front();
        }
        self.last.push_back(link.status());
    }
}

impl QosCounts {
    pub(super) fn add(&mut self, watch: &QosWatch) {
        self.missed_deadlines += watch.missed_deadlines();
        self.lost_liveliness += watch.lost_liveliness();
    }
}
