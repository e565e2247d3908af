//! The lifespan of messages: those that are older are neither sent nor handed out.

use super::{
    Delivery, Error, Fate, Link, LinkMemory, Misuse, Output, Wake, lane::Lane, machine::Over,
    ring::NotReleased,
};
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
        self.config.lifespan != Period::NONE && self.config.lifespan.has_passed(time, now())
    }

    /// Gives back a message that [`take`](Self::take) returned and that [has expired](Self::is_expired), so that the
    /// application does not see it. Returns whether the sender has to be woken.
    ///
    /// # Errors
    /// As [`release`](Self::release).
    //= SM2-QOS-010
    pub fn expire(&mut self, memory: &impl LinkMemory, delivery: &Delivery) -> Result<Wake, Error> {
        let sequence = delivery.sequence;
        let result = match (&mut self.lane, self.state) {
            (Lane::Undecided, Ok(_)) => Err(Misuse::NotOpen.into()),
            (Lane::Undecided, Err(Over { end, .. })) => Err(Error::Ended(end)),
            (Lane::Socket(socket), Ok(_)) => match socket.inbound.expire(sequence) {
                true => Ok(Wake::NotNeeded),
                false => Err(Misuse::NotBorrowed.into()),
            },
            (Lane::Socket(socket), Err(Over { end, .. })) => {
                socket.inbound.forget(sequence);
                Err(Error::Ended(end))
            }
            (Lane::Ring(ring), state) => {
                let (receiver, words) = match (&mut ring.incoming, memory.incoming()) {
                    (Some(receiver), Some(words)) => (receiver, words),
                    (Some(_), None) => return Err(Misuse::NotLent.into()),
                    (None, _) => return Err(Misuse::WrongRole.into()),
                };
                // The word is put even after the end, as by `release`.
                match (state, receiver.expire(words, sequence)) {
                    (Err(Over { end, .. }), _) => Err(Error::Ended(end)),
                    (Ok(_), Ok(wake)) => Ok(wake),
                    (Ok(_), Err(NotReleased::Misuse(misuse))) => Err(misuse.into()),
                    (Ok(_), Err(NotReleased::Violation(violation))) => {
                        Err(self.violated(violation))
                    }
                }
            }
        };
        self.invariants();
        result
    }
}
