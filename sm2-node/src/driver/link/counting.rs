//! Writes what happens to the messages of a link into its counters, which tools can read.

use sm2_proto::Instant;
use sm2_proto::link::Role;

use super::LinkDriver;
use crate::driver::counters::note;

impl LinkDriver {
    /// Counts a message that was sent.
    pub(in crate::driver) fn note_sent(&mut self, time: Instant, len: u64) {
        let at = match self.role() {
            // A server's entry counts requests, not replies.
            Role::Server => return self.note_fates(),
            // A request carries its deadline, not the time at which it was sent.
            Role::Caller => sm2_io::clock::now(),
            Role::Sender | Role::Receiver => time,
        };
        self.noted = self.counters();
        note(self.entry.as_mut(), |entry| {
            entry.published(at, len);
            entry.fates(&self.noted);
        });
    }

    /// Writes the outcomes of messages to the entry, if they have changed.
    pub(in crate::driver) fn note_fates(&mut self) {
        let counters = self.counters();
        if counters != self.noted {
            self.noted = counters;
            note(self.entry.as_mut(), |entry| entry.fates(&counters));
        }
    }
}
