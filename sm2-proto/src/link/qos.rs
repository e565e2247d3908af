//! The deadline and the lease of a topic's link. Both roles need ticks for them.

use super::{Config, Misuse, Role, phase::Phase};
use crate::{Instant, Newest, Period, QosWatch, Violation, qos::AliveFrames};

/// A receiver watches the publisher at the other end. A sender tells the receiver that its program is alive.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct QosTimers {
    /// Of a receiver, from the time when the link opened.
    pub(super) watch: QosWatch,
    /// Of a sender whose receiver demands a lease.
    alive_frames: AliveFrames,
}

impl QosTimers {
    /// A receiver watches the publisher from the time when the link opens.
    //= SM2-QOS-009, SM2-QOS-011
    pub(super) fn start_watch(&mut self, config: &Config, now: Instant) {
        if config.role == Role::Receiver && self.watch.due().is_none() {
            self.watch = QosWatch::new(config.deadline, config.lease, now);
        }
    }

    /// Handles [`Input::Tick`](super::Input::Tick).
    //= SM2-QOS-009, SM2-QOS-011, SM2-QOS-012
    pub(super) fn tick(&mut self, config: &Config, now: Instant, newest: Newest) {
        if self.next_tick().is_some() {
            self.watch.check(newest, now);
            self.alive_frames.send_held(config.lease, now);
        }
    }

    /// The time of the next [`Input::Tick`](super::Input::Tick).
    pub(super) fn next_tick(&self) -> Option<Instant> {
        self.watch.due().or(self.alive_frames.held_until())
    }

    /// Sends an assertion of the publisher's program.
    //= SM2-QOS-012
    pub(super) fn assert_liveliness(
        &mut self,
        config: &Config,
        phase: Phase,
        time: Instant,
    ) -> Result<(), Misuse> {
        if config.role != Role::Sender {
            return Err(Misuse::WrongRole);
        }
        if phase != Phase::Open {
            return Err(Misuse::NotOpen);
        }
        self.show_life(config, time);
        Ok(())
    }

    /// The publisher's program is alive at this time.
    pub(super) fn show_life(&mut self, config: &Config, time: Instant) {
        if config.lease != Period::NONE {
            self.alive_frames.assert(config.lease, time);
        }
    }

    /// The time in the ALIVE that is sent now, if one has to be sent.
    pub(super) const fn take_alive(&mut self) -> Option<Instant> {
        self.alive_frames.take()
    }

    //= SM2-QOS-012
    pub(super) fn on_alive(
        &mut self,
        config: &Config,
        time: Instant,
        now: Instant,
    ) -> Result<(), Violation> {
        if config.lease == Period::NONE {
            return Err(violation!(WrongRole, "SM2-QOS-012"));
        }
        self.watch.assert(time, now);
        Ok(())
    }
}
