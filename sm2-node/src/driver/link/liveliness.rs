//! The liveliness of the publisher at the other end of a subscriber's link.

use super::LinkDriver;
use crate::driver::counters::note;

impl LinkDriver {
    /// How often the publisher stopped being alive.
    pub(in crate::driver) fn lost_liveliness(&self) -> u64 {
        self.machine.lost_liveliness()
    }

    /// Whether the publisher is alive, if that has changed since the last call.
    #[inline]
    pub(in crate::driver) fn take_liveliness_change(&mut self) -> Option<bool> {
        let change = self.machine.take_liveliness_change();
        if change == Some(false) {
            note(self.entry.as_mut(), |entry| entry.lost_liveliness());
        }
        change
    }
}
