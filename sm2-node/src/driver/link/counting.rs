//! Writes what happens to the messages of a link into its counters, which tools can read.

use std::mem;

use sm2_proto::Instant;
use sm2_proto::link::Role;

use super::LinkDriver;
use crate::driver::counters::update;

impl LinkDriver {
    /// Counts a message that was sent at `now`.
    #[inline]
    pub(in crate::driver) fn count_sent(&mut self, time: Instant, len: u64, now: Instant) {
        let at = match self.role() {
            // A server's entry counts requests, not replies.
            Role::Server => return self.write_fates(),
            // A request carries its deadline, not the time at which it was sent.
            Role::Caller => now,
            Role::Sender | Role::Receiver => time,
        };
        let counters = self.counters();
        // Sending changes no other count.
        self.written.offered = counters.offered;
        self.written.delivered = counters.delivered;
        self.written.overwritten = counters.overwritten;
        self.written.discarded = counters.discarded;
        self.written.in_flight = counters.in_flight;
        update(self.entry.as_mut(), |entry| {
            entry.published(at, len);
            entry.sent(&counters);
        });
    }

    /// Memory is short, on this end of the link.
    //= SM2-TRN-013
    #[cold]
    pub(super) fn be_short_of_memory(&mut self) {
        self.short_of_memory = true;
        self.write_shortage();
    }

    /// Writes the begin or the end of a shortage of memory to the entry.
    pub(super) fn write_shortage(&mut self) {
        if self.short_of_memory != self.written_short {
            self.written_short = self.short_of_memory;
            let since = self.short_of_memory.then(sm2_io::clock::now);
            update(self.entry.as_mut(), |entry| entry.short_since(since));
        }
    }

    /// Writes the outcomes of messages to the entry, if they have changed.
    pub(in crate::driver) fn write_fates(&mut self) {
        let counters = self.counters();
        if counters != self.written {
            self.written = counters;
            update(self.entry.as_mut(), |entry| entry.fates(&counters));
        }
    }

    /// How many more messages of a publisher the other side does not get than at the last call. Messages whose fate
    /// the end of the link hides are not among them.
    pub(in crate::driver) fn take_new_drops(&mut self) -> u64 {
        if self.role() != Role::Sender {
            return 0;
        }
        let counters = self.counters();
        let dropped = counters.dropped().saturating_sub(counters.closed);
        dropped.saturating_sub(mem::replace(&mut self.reported_drops, dropped))
    }
}
