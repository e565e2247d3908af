//! Writes what happens to the messages of a link into its counters, which tools can read.

use std::mem;

use sm2_io::CounterEntry;
use sm2_proto::Instant;
use sm2_proto::link::{Counters, Role};

use crate::driver::counters::update;

/// The entry of a link, and what was written there or reported to the program.
#[derive(Debug, Default)]
pub(in crate::driver) struct LinkCounting {
    /// The entry, until the end of the link is noticed.
    pub(in crate::driver) entry: Option<CounterEntry>,
    /// The outcomes of messages in the entry.
    written: Counters,
    /// Whether the entry says that memory is short.
    is_written_short: bool,
    /// How many messages that the other side does not get were reported to the program.
    reported_drops: u64,
}

impl LinkCounting {
    pub(super) fn new(entry: Option<CounterEntry>) -> Self {
        Self {
            entry,
            ..Self::default()
        }
    }

    /// Counts a message that was sent at `now`.
    #[inline]
    pub(super) fn count_sent(
        &mut self,
        role: Role,
        counters: &Counters,
        (time, len): (Instant, u64),
        now: Instant,
    ) {
        let at = match role {
            // A server's entry counts requests, not replies.
            Role::Server => return self.write_fates(counters),
            // A request carries its deadline, not the time of its sending.
            Role::Caller => now,
            Role::Sender | Role::Receiver => time,
        };
        // Sending changes no other count.
        self.written.offered = counters.offered;
        self.written.delivered = counters.delivered;
        self.written.overwritten = counters.overwritten;
        self.written.discarded = counters.discarded;
        self.written.in_flight = counters.in_flight;
        update(self.entry.as_mut(), |entry| {
            entry.published(at, len);
            entry.sent(counters);
        });
    }

    /// Writes the begin or the end of a shortage of memory to the entry.
    //= SM2-TRN-013
    pub(super) fn write_shortage(&mut self, is_short: bool) {
        if is_short != self.is_written_short {
            self.is_written_short = is_short;
            let since = is_short.then(sm2_io::clock::now);
            update(self.entry.as_mut(), |entry| entry.short_since(since));
        }
    }

    /// Writes the outcomes of messages to the entry, if they have changed.
    pub(super) fn write_fates(&mut self, counters: &Counters) {
        if *counters != self.written {
            self.written = *counters;
            update(self.entry.as_mut(), |entry| entry.fates(counters));
        }
    }

    /// How many more messages of a publisher the other side does not get than at the last call. Messages whose fate
    /// the end of the link hides are not among them.
    pub(super) fn take_new_drops(&mut self, counters: &Counters) -> u64 {
        let dropped = counters.dropped().saturating_sub(counters.closed);
        dropped.saturating_sub(mem::replace(&mut self.reported_drops, dropped))
    }
}
