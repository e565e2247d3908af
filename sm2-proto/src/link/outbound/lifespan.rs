//! Messages of the socket lane that are older than their lifespan.

use super::{Outbound, OutboundMessage, slot_of};
use crate::Instant;

impl Outbound {
    /// Counts a publication that is not sent on this link because it is older than its lifespan.
    //= SM2-QOS-010
    pub(in crate::link) const fn drop_expired(&mut self) {
        self.counters.offered += 1;
        self.counters.expired += 1;
    }

    /// Drops the messages that were not sent and are older than their lifespan. Passes their keys to `each`.
    //= SM2-QOS-010
    pub(in crate::link) fn expire(&mut self, now: Instant, mut each: impl FnMut(u64)) {
        let lifespan = self.lifespan;
        let is_over = |it: Option<&OutboundMessage>| {
            it.is_some_and(|message| lifespan.has_passed(message.time, now))
        };
        loop {
            // The admitted messages are older than those that wait.
            let message = if is_over(self.admitted.front()) {
                self.admitted.pop_front()
            } else if self.admitted.is_empty() && is_over(self.waiting.front()) {
                self.waiting.pop_front()
            } else {
                None
            };
            let Some(message) = message else { break };
            self.counters.expired += 1;
            self.settle(message.id, slot_of(&message.body), false);
            each(message.key);
            self.admit();
        }
    }
}
