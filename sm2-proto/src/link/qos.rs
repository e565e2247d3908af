//! The QoS of a topic's link: the deadline and the lease of a receiver, and the lifespan of the messages.

use super::{
    Delivery, Error, Fate, Link, LinkMemory, Misuse, Output, Role, Wake, lane::Lane, phase::Phase,
    wire::Given,
};
use crate::{Instant, Machine, Newest, Period, QosWatch, Violation};

impl Link {
    /// A receiver watches the publisher from the time when the link opens.
    //= SM2-QOS-009, SM2-QOS-011
    pub(super) fn start_watch(&mut self, now: Instant) {
        let is_open_receiver = self.config.role == Role::Receiver && self.state == Ok(Phase::Open);
        if is_open_receiver && self.watch.due().is_none() {
            self.watch = QosWatch::new(self.config.deadline, self.config.lease, now);
        }
    }

    /// Handles [`Input::Tick`](super::Input::Tick).
    //= SM2-QOS-009, SM2-QOS-011, SM2-QOS-012
    pub(super) fn tick(&mut self, now: Instant, newest: Newest) {
        if self.deadline().is_some() {
            self.watch.check(newest, now);
            self.alive_frames.send_held(self.config.lease, now);
        }
    }

    /// The newest message that has come, whether it was taken or not, for [`Input::Tick`](super::Input::Tick).
    #[must_use]
    pub fn newest(&self, memory: &impl LinkMemory) -> Newest {
        match &self.lane {
            Lane::Undecided => Newest::NONE,
            Lane::Socket(socket) => socket.inbound.newest(),
            Lane::Ring(ring) => match (&ring.incoming, memory.incoming()) {
                (Some(receiver), Some(words)) => receiver.newest(words),
                _ => Newest::NONE,
            },
        }
    }

    /// The time of the next [`Input::Tick`](super::Input::Tick).
    pub(super) fn next_tick(&self) -> Option<Instant> {
        let due = self.watch.due().or(self.alive_frames.held_until());
        due.filter(|_| self.state.is_ok())
    }

    /// How the publisher at the other end keeps its deadline and its lease, as far as the last
    /// [tick](super::Input::Tick) and the last ALIVE tell. Watches nothing for all roles but a receiver.
    #[must_use]
    #[inline]
    pub const fn watch(&self) -> &QosWatch {
        &self.watch
    }

    /// As [`watch`](Self::watch), to take the changes since the last call.
    #[inline]
    pub const fn watch_mut(&mut self) -> &mut QosWatch {
        &mut self.watch
    }

    /// Sends an assertion of the publisher's program.
    //= SM2-QOS-012
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
        if self.config.lease != Period::NONE {
            self.alive_frames.assert(self.config.lease, time);
        }
    }

    //= SM2-QOS-012
    pub(super) fn on_alive(&mut self, time: Instant, now: Instant) -> Result<(), Violation> {
        if self.config.lease == Period::NONE {
            return Err(violation!(WrongRole, "SM2-QOS-012"));
        }
        self.watch.assert(time, now);
        Ok(())
    }

    /// Drops the messages that wait at this end and are older than their lifespan. Each input does so.
    //= SM2-QOS-010
    pub(super) fn expire_unsent(&mut self, now: Instant) {
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
