//! The losses of a link, as its two ends count them.

use sm2_node::diagnostics::{Counters, LinkStatus};

use crate::gap::GapReason;

/// The losses on a link that are known so far.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Known {
    pool_limit: u64,
    no_room: u64,
    /// Messages that were not sent because they were too old.
    expired_unsent: u64,
    /// Messages that were too old when the recorder would have taken them. The next message does not show that they
    /// are missing.
    expired_taken: u64,
}

/// Messages that a link has lost since the last look.
#[derive(Clone, Copy, Debug)]
pub(super) struct Loss {
    pub(super) reason: GapReason,
    pub(super) messages: u64,
    /// Whether the number of the next message shows that they are missing.
    pub(super) is_shown: bool,
}

impl Known {
    /// Takes over the state of a link, and the fates of its messages if they are known. Returns the new losses.
    pub(super) fn advance(&mut self, link: &LinkStatus, fates: Option<&Counters>) -> [Loss; 4] {
        let mut now = *self;
        now.expired_taken = now.expired_taken.max(link.received.expired);
        if let Some(fates) = fates {
            now.pool_limit = now.pool_limit.max(fates.pool_limit);
            now.no_room = now.no_room.max(fates.no_room);
            // The publisher counts both kinds together.
            let unsent = fates.expired.saturating_sub(now.expired_taken);
            now.expired_unsent = now.expired_unsent.max(unsent);
        }
        let before = std::mem::replace(self, now);
        let loss = |reason, before, now, is_shown| Loss {
            reason,
            messages: now - before,
            is_shown,
        };
        [
            loss(
                GapReason::PoolLimit,
                before.pool_limit,
                now.pool_limit,
                true,
            ),
            loss(GapReason::NoRoom, before.no_room, now.no_room, true),
            loss(
                GapReason::Expired,
                before.expired_unsent,
                now.expired_unsent,
                true,
            ),
            loss(
                GapReason::Expired,
                before.expired_taken,
                now.expired_taken,
                false,
            ),
        ]
    }
}
