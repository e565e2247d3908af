//! Liveliness: a publisher's program asserts that it is alive, and a receiver notices when it does not.

use super::{Link, Misuse, Role, lease::Lease, phase::Phase};
use crate::{Instant, LeaseWatch, Period, Violation};

impl Link {
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
}
