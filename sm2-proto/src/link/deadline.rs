//! The deadline of a receiver: how many periods pass without a message.

use super::{Link, LinkMemory, lane::Lane, phase::Phase};
use crate::{DeadlineWatch, Instant, Machine, Newest};

impl Link {
    /// Starts the first period once the link is open.
    //= SM2-QOS-009
    pub(super) fn start_deadline(&mut self, now: Instant) {
        if self.watch.is_none() && self.state == Ok(Phase::Open) {
            self.watch = DeadlineWatch::new(self.config.deadline, now);
        }
    }

    /// Receiver: counts the periods of the deadline that have passed without a message, and checks whether the
    /// publisher is alive. Sender: sends ALIVE if it was held back.
    /// A driver calls this at the time of [`deadline`](crate::Machine::deadline), after it has fed all datagrams that
    /// the socket has.
    //= SM2-QOS-009, SM2-QOS-012
    pub fn tick(&mut self, now: Instant, memory: &impl LinkMemory) {
        if self.deadline().is_some() {
            let newest = self.newest(memory);
            if let Some(watch) = &mut self.watch {
                watch.check(newest, now);
            }
            if let Some(watch) = &mut self.lease.watch {
                watch.check(newest, now);
            }
            self.send_held_alive(now);
        }
        self.invariants();
    }

    fn newest(&self, memory: &impl LinkMemory) -> Newest {
        match &self.lane {
            Lane::Undecided => Newest::NONE,
            Lane::Socket(socket) => socket.inbound.newest(),
            Lane::Ring(ring) => match (&ring.incoming, memory.incoming()) {
                (Some(receiver), Some(words)) => receiver.newest(words),
                _ => Newest::NONE,
            },
        }
    }

    /// How many periods of the deadline have passed without a message. Zero for all roles but a receiver.
    #[must_use]
    pub fn missed_deadlines(&self) -> u64 {
        self.watch.as_ref().map_or(0, DeadlineWatch::missed)
    }

    /// The end of the present period, as long as the link is not over.
    pub(super) fn period_end(&self) -> Option<Instant> {
        let watch = self.watch.as_ref().filter(|_| self.state.is_ok())?;
        Some(watch.due())
    }
}
