//! The events of a link that the control side handles.
//!
//! Calls of the program read DATA and RELEASE, so these packets do not wake the background thread. The control side
//! reads a link while it is opening, while messages wait in this process for packets of the other side, and at its end.

use super::LinkDriver;
use crate::driver::event_sets::{BackgroundInterest, LinkSets};

/// How often in a row calls find that the background thread is woken for packets that it need not read.
const NEEDLESS_WATCHES_MAX: u8 = 16;

impl LinkDriver {
    /// The events that nothing but the background thread may be there to handle.
    fn wanted_in_background(&self) -> BackgroundInterest {
        if self.unsent.is_some() || self.bell_due {
            BackgroundInterest::Room
        } else if self.is_opening() || self.machine.has_queued() || !self.backlog.is_empty() {
            BackgroundInterest::Packets
        } else {
            BackgroundInterest::End
        }
    }

    /// Wakes the background thread for the events that it has to handle from now on. A system call for each change
    /// would cost more than a few needless wake-ups. Packets therefore wake the thread until it handles one
    /// ([`after_background_event`](Self::after_background_event)), or until calls have read [`NEEDLESS_WATCHES_MAX`] of
    /// them before it.
    #[inline]
    pub(in crate::driver) fn watch_in_background(&mut self, sets: &LinkSets) {
        let wanted = self.wanted_in_background();
        if wanted != BackgroundInterest::End || self.in_background == BackgroundInterest::Room {
            self.set_background(wanted, sets);
        } else if self.in_background == BackgroundInterest::Packets {
            self.needless_watches += 1;
            if self.needless_watches == NEEDLESS_WATCHES_MAX {
                self.set_background(wanted, sets);
            }
        }
    }

    /// Stops waking the background thread for packets if no message waits for them.
    pub(in crate::driver) fn after_background_event(&mut self, sets: &LinkSets) {
        self.set_background(self.wanted_in_background(), sets);
    }

    fn set_background(&mut self, wanted: BackgroundInterest, sets: &LinkSets) {
        self.needless_watches = 0;
        if wanted == self.in_background {
            return;
        }
        if let Some(socket) = &self.socket
            && (sets.watch_link_in_background(socket, self.origin.token, wanted)).is_ok()
        {
            self.in_background = wanted;
        }
    }
}
