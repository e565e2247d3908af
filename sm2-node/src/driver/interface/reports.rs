//! The reports of an interface for a program.

use sm2_proto::link::Counters;

use super::Interface;
use crate::driver::link::LinkDriver;
use crate::driver::status::LinkStatus;

impl Interface {
    /// The statuses of all links, ended links first.
    pub(crate) fn statuses(&self) -> Vec<LinkStatus> {
        let live = self
            .links()
            .filter(|link| !link.end_noticed)
            .map(LinkDriver::status);
        self.ended.iter().cloned().chain(live).collect()
    }

    /// The sum over all links of the interface, current and past.
    //= SM2-QOS-006
    pub(crate) fn counters(&self) -> Counters {
        let mut sum = self.ended_sum;
        for link in self.links().filter(|link| !link.end_noticed) {
            sum.add(&link.counters());
        }
        sum
    }
}
