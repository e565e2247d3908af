//! The lifespan of messages: those that are older are neither sent nor handed out.

use super::{Delivery, Error, Fate, Link, LinkMemory, Output, Wake, lane::Lane, wire::Given};
use crate::{Instant, Period};

impl Link {
    /// Drops the messages that wait at this end and are older than their lifespan. A driver calls this before it asks
    /// whether there is room; each input does so as well.
    //= SM2-QOS-010
    pub fn expire_unsent(&mut self, now: Instant) {
        if self.config.lifespan == Period::NONE || self.state.is_err() {
            return;
        }
        let Self { lane, events, .. } = self;
        if let Lane::Socket(socket) = lane {
            socket.outbound.expire(now, |key| {
                events.push_back(Output::Settled {
                    key,
                    fate: Fate::Expired,
                });
            });
        }
        self.invariants();
    }

    /// Whether a message with this time of publication is older than its lifespan now.
    //= SM2-QOS-010
    #[must_use]
    #[inline]
    pub fn is_expired(&self, time: Instant, now: impl FnOnce() -> Instant) -> bool {
        self.config.lifespan.has_passed_by(time, now)
    }

    /// Gives back a message that [`take`](Self::take) returned and that [has expired](Self::is_expired), so that the
    /// application does not see it. Returns whether the sender has to be woken.
    ///
    /// # Errors
    /// As [`release`](Self::release).
    //= SM2-QOS-010
    pub fn expire(&mut self, memory: &impl LinkMemory, delivery: &Delivery) -> Result<Wake, Error> {
        self.give_back(memory, [delivery.sequence], Given::Expired)
    }
}
