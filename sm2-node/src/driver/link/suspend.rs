//! Links that get no message until their receiver releases one.

use super::LinkDriver;

impl LinkDriver {
    /// Whether the link was suspended and has released nothing since.
    #[inline]
    pub(in crate::driver) fn is_suspended(&self) -> bool {
        self.suspended
            .is_some_and(|released| released == self.released())
    }

    /// Whether the link was suspended, and its receiver has released something since.
    #[inline]
    pub(in crate::driver) fn is_resuming(&self) -> bool {
        self.suspended.is_some() && !self.is_suspended()
    }

    pub(in crate::driver) fn suspend(&mut self) {
        tracing::debug!(link = %self.id, peer = %self.origin.peer.name, "suspended at the pool limit");
        self.suspended = Some(self.released());
    }

    /// Makes the link active again if its receiver has released something.
    pub(in crate::driver) fn resume_if_released(&mut self) {
        if self.is_resuming() {
            self.suspended = None;
        }
    }

    /// How many messages were released. A message that has expired gives its memory back as well.
    //= SM2-QOS-010
    fn released(&self) -> u64 {
        let counters = self.counters();
        counters.delivered + counters.discarded + counters.expired
    }

    /// Passes the key of each message in flight to `each`.
    pub(in crate::driver) fn in_flight_keys(&self, each: impl FnMut(u64)) {
        self.machine.in_flight_keys(each);
    }
}
