//! Waiting for subscribers that want every message, in steps that a signal can end.
//!
//! A publisher's own wait for room ends with room or at its timeout. A command must end as soon as a signal
//! comes: it checks for room before it publishes, and publishes with a timeout of zero.

use std::{collections::HashMap, time::Duration};

use sm2_proto::{Instant, LinkId, link::Counters};

/// The number of messages that one link may have in flight. A publisher of this depth then has room for them,
/// however small the window of the subscriber is.
pub(super) const DEPTH: u16 = 64;

/// A reliable subscriber that receives nothing for this time no longer delays the publisher.
pub(super) const TIMEOUT: Duration = Duration::from_secs(10);

/// The links without room, and the number of messages that certainly have room.
#[derive(Clone, Debug)]
pub(super) struct Room {
    full: HashMap<LinkId, Full>,
    /// The number of messages that one link may have in flight.
    most: u64,
    /// The number of messages that have room on every link.
    sure: u64,
}

#[derive(Clone, Copy, Debug)]
struct Full {
    delivered: u64,
    /// The time since which the subscriber has received nothing.
    since: Instant,
}

impl Default for Room {
    fn default() -> Self {
        Self {
            full: HashMap::new(),
            most: u64::from(DEPTH),
            sure: 0,
        }
    }
}

impl Room {
    /// Lowers the number of messages in flight to those that fit into a quarter of the pool, after a message
    /// of this length. A slot is at most twice as long as its message; half of the pool is not for messages in
    /// flight (SM2-QOS-006).
    pub(super) fn fit(&mut self, pool_bytes: u64, message_len: u64) {
        let fitting = (pool_bytes / 4 / message_len.max(1)).max(1);
        if fitting < self.most {
            (self.most, self.sure) = (fitting, 0);
        }
    }

    /// Returns true if the next message certainly has room, and counts it as published.
    pub(super) fn take(&mut self) -> bool {
        let sure = self.sure > 0;
        self.sure = self.sure.saturating_sub(1);
        sure
    }

    /// Checks all open reliable links. Returns true if each link has room for a message or has passed its
    /// timeout.
    pub(super) fn look(
        &mut self,
        now: Instant,
        links: impl IntoIterator<Item = (LinkId, Counters)>,
    ) -> bool {
        let before = std::mem::take(&mut self.full);
        let mut least = self.most;
        for (id, counters) in links {
            let room = self.most.saturating_sub(counters.in_flight);
            if room > 0 {
                least = least.min(room);
                continue;
            }
            let delivered = counters.delivered;
            let known = before.get(&id).filter(|it| it.delivered == delivered);
            let since = known.map_or(now, |known| known.since);
            self.full.insert(id, Full { delivered, since });
            if now.since(since) < TIMEOUT {
                least = 0;
            }
        }
        self.sure = least;
        least > 0
    }
}

#[cfg(test)]
mod tests;
