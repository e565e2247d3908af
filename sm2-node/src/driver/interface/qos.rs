//! The deadline and the lease of an interface: of its publisher, and of the publishers at the other ends of its links.

use sm2_proto::{Contract, Instant, Newest, Period, QosWatch};

use super::links::{Links, QosCounts};
use super::reports::Reports;
use crate::driver::link::LinkDriver;

/// Knows how the publisher keeps its deadline and its lease, and when the interface has to be ticked to find out about
/// periods without a message.
#[derive(Debug)]
pub(super) struct QosMonitor {
    /// The deadline and the lease of a publisher. Watches nothing at all other interfaces.
    own: QosWatch,
    /// Whether the interface, or the other ends of its links, have a deadline or a lease.
    is_ticked: bool,
    /// The time of the next tick, if the control side knows one.
    tick_at: Option<Instant>,
}

impl QosMonitor {
    pub(super) fn of(contract: &Contract) -> Self {
        Self {
            own: match contract {
                Contract::Publisher { offer, .. } => {
                    QosWatch::new(offer.deadline, offer.lease, sm2_io::clock::now())
                }
                Contract::Subscriber { .. } | Contract::Server { .. } | Contract::Client { .. } => {
                    QosWatch::default()
                }
            },
            is_ticked: contract.deadline() != Period::NONE || contract.lease() != Period::NONE,
            tick_at: None,
        }
    }

    #[inline]
    pub(super) const fn has_lease(&self) -> bool {
        self.own.has_lease()
    }

    /// The publisher publishes a message at this time, which asserts its liveliness. Returns whether it was alive.
    #[inline]
    pub(super) fn publish(&mut self, time: Instant) -> bool {
        let was_alive = self.own.is_alive();
        self.own.published(time);
        was_alive
    }

    /// The program asserts the liveliness of its publisher at this time.
    pub(super) fn assert(&mut self, time: Instant, reports: &mut Reports) {
        self.own.assert(time, time);
        reports.report_liveliness(self.own.take_liveliness_change(), None);
    }

    /// Counts the periods that have passed without a message of this publisher, and checks whether it is alive.
    pub(super) fn tick(&mut self, now: Instant, reports: &mut Reports) {
        self.tick_at = None;
        self.own.check(Newest::NONE, now);
        reports.count_missed(self.own.take_missed(), None);
        reports.report_liveliness(self.own.take_liveliness_change(), None);
    }

    /// The end of the next period, if the control side does not know of a tick before. From now on it does.
    #[inline]
    pub(super) fn next_tick(&mut self, links: &Links) -> Option<Instant> {
        if !self.is_ticked {
            return None;
        }
        let due = links.iter().filter_map(LinkDriver::deadline);
        let due = due.chain(self.own.due()).min()?;
        if self.tick_at.is_some_and(|known| known <= due) {
            return None;
        }
        self.tick_at = Some(due);
        self.tick_at
    }

    /// The counts of this publisher, or of all links of a subscriber, current and past.
    pub(super) fn counts(&self, links: &Links) -> QosCounts {
        let mut sum = links.qos_counts();
        sum.add(&self.own);
        sum
    }
}
