//! The QoS of a topic's link: the deadline and the lease of a receiver, and the lifespan of the messages.

use super::{
    Delivery, Error, Fate, Link, LinkMemory, Misuse, Output, Role, Wake, lane::Lane, lease::Lease,
    phase::Phase, wire::Given,
};
use crate::{DeadlineWatch, Instant, LeaseWatch, Machine, Newest, Period, Violation};

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

    /// Notes an assertion of the publisher's program. If the one before was not sent yet, only this one is.
    //= SM2-QOS-013
    pub(super) fn assert_liveliness(&mut self, time: Instant) -> Result<(), Misuse> {
        if self.config.role != Role::Sender {
            return Err(Misuse::WrongRole);
        }
        if self.state != Ok(Phase::Open) {
            return Err(Misuse::NotOpen);
        }
        self.show_life(time);
        Ok(())
    }

    /// The publisher's program is alive at this time.
    pub(super) fn show_life(&mut self, time: Instant) {
        if self.config.lease == Period::NONE {
            return;
        }
        if self.lease.due.is_none() && time < self.lease.next {
            self.lease.held = Some(time);
        } else {
            self.send_alive(time, time);
        }
    }

    /// Sends the assertion that was held back, once it is time.
    //= SM2-QOS-013
    pub(super) fn send_held_alive(&mut self, now: Instant) {
        if now >= self.lease.next
            && let Some(time) = self.lease.held
        {
            self.send_alive(time, now);
        }
    }

    fn send_alive(&mut self, time: Instant, now: Instant) {
        let quarter = self.config.lease.0 / 4;
        self.lease.due = Some(time);
        self.lease.held = None;
        self.lease.next = Instant(now.0.saturating_add(quarter));
    }

    //= SM2-QOS-013
    pub(super) fn on_alive(&mut self, time: Instant) -> Result<(), Violation> {
        if self.config.lease == Period::NONE {
            return Err(violation!(WrongRole, "SM2-QOS-013"));
        }
        self.lease.came = Some(time);
        Ok(())
    }

    /// Starts to watch once the link is open, and notes an assertion that came.
    //= SM2-QOS-012
    pub(super) fn watch_liveliness(&mut self, now: Instant) {
        if self.config.role != Role::Receiver || self.state != Ok(Phase::Open) {
            return;
        }
        let Lease { watch, came, .. } = &mut self.lease;
        if watch.is_none() {
            *watch = LeaseWatch::new(self.config.lease, now);
        }
        if let (Some(watch), Some(time)) = (watch, came.take()) {
            watch.assert(time, now);
        }
    }

    /// Whether the publisher at the other end has shown in time that its program is alive, as far as the last
    /// [`tick`](Self::tick) and the last ALIVE tell. Always true without a lease, and for all roles but a receiver.
    #[must_use]
    pub fn is_peer_alive(&self) -> bool {
        (self.lease.watch.as_ref()).is_none_or(LeaseWatch::is_alive)
    }

    /// Whether the publisher at the other end [is alive](Self::is_peer_alive), if that has changed since the last call.
    #[inline]
    pub fn take_liveliness_change(&mut self) -> Option<bool> {
        self.lease.watch.as_mut()?.take_change()
    }

    /// How often the publisher at the other end has lost its liveliness.
    #[must_use]
    pub fn lost_liveliness(&self) -> u64 {
        self.lease.watch.as_ref().map_or(0, LeaseWatch::losses)
    }

    /// The time at which the liveliness is checked next, or at which an assertion is sent that was held back.
    pub(super) fn lease_end(&self) -> Option<Instant> {
        if self.state.is_err() {
            return None;
        }
        let held = self.lease.held.map(|_| self.lease.next);
        self.lease.watch.as_ref().map(LeaseWatch::due).or(held)
    }

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
