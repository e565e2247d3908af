//! Waiting for a message, at the pace of the program.

use sm2_io::clock::{last_tick, now};
use sm2_proto::Contract;

use super::shared_interface::{Drive, LockedInterface, SharedInterface};
use super::wait::{Until, WaitFailure};
use crate::Wait;

impl SharedInterface {
    /// Looks for a message, and waits for it as [`wait_as`](Self::wait_as) does. In quick succession, most calls do not
    /// read the clock: see `Pace`.
    #[inline]
    pub(crate) fn wait_for_message<T>(
        &self,
        way: Wait,
        until: Until,
        mut look: impl FnMut(&mut LockedInterface<'_>) -> Option<T>,
    ) -> Result<Option<T>, WaitFailure> {
        let mut locked = self.lock();
        let mut time = locked.now;
        // A server has to know whether a request is late.
        let is_subscriber = matches!(locked.interface().contract, Contract::Subscriber { .. });
        if !(is_subscriber && locked.pace.goes_on(last_tick)) {
            time = now();
            locked.pace.read(time, last_tick);
        }
        locked = self.begin(locked, time, Drive::IfDue);
        if let Some(found) = look(&mut locked) {
            locked.pace.found();
            return Ok(Some(found));
        }
        locked.pace.ended();
        drop(locked);
        self.wait_as(way, until, look)
    }
}
