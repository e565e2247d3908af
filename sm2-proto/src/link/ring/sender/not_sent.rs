//! Counts of publications that are not sent on a link of the ring lane.

use super::RingSender;

impl RingSender {
    /// Counts a message whose deadline passed while the application waited for room.
    //= SM2-QOS-014
    pub(in crate::link) const fn skip(&mut self) {
        self.counters.offered += 1;
        self.counters.deadline += 1;
        self.debt.incur(self.sequence, self.unreleased as u64);
    }

    /// Counts a publication that is not sent on this link.
    pub(in crate::link) const fn pass_over(&mut self) {
        self.counters.offered += 1;
        self.counters.overwritten += 1;
    }

    /// Counts a publication that is not sent on this link because of the pool limit.
    //= SM2-QOS-017
    pub(in crate::link) const fn hold_back(&mut self) {
        self.counters.offered += 1;
        self.counters.pool_limit += 1;
        self.debt.incur(self.sequence, self.unreleased as u64);
    }

    /// Counts a publication that is not sent on this link because it is longer than the other end
    /// accepts.
    //= SM2-QOS-008
    pub(in crate::link) const fn drop_too_long(&mut self) {
        self.counters.offered += 1;
        self.counters.too_long += 1;
    }

    /// Counts a publication that is not sent on this link because it is older than its lifespan.
    //= SM2-QOS-010
    pub(in crate::link) const fn drop_expired(&mut self) {
        self.counters.offered += 1;
        self.counters.expired += 1;
    }
}
