//! The losses of a link, as its two ends count them.

use std::mem;

use sm2_node::diagnostics::{Counters, LinkStatus};
use sm2_proto::link::Fate;

use crate::gap::GapReason;

/// The losses on a link that are known so far.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Known {
    /// Messages that were not sent, by [`GapReason::unsent`].
    unsent: Counters,
    /// Messages that were displaced on the link, or published while their publisher had no link. The number of the next
    /// message shows that they are missing, and the recorder counts them then.
    displaced: u64,
    away: u64,
    /// Messages that were too old when the recorder would have taken them. The next message does not show that they
    /// are missing.
    expired_taken: u64,
}

/// The news of a link since the last look.
pub(super) struct Look<Losses> {
    /// Messages that were displaced, or published while their publisher had no link.
    pub(super) displaced: u64,
    /// The losses for other reasons.
    pub(super) losses: Losses,
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
    /// Takes over the state of a link, and the fates of its messages if they are known. Returns what is new.
    pub(super) fn advance(
        &mut self,
        link: &LinkStatus,
        fates: Option<&Counters>,
    ) -> Look<impl Iterator<Item = Loss> + use<>> {
        let mut now = *self;
        now.expired_taken = now.expired_taken.max(link.received.expired);
        now.away = now.away.max(link.received.away);
        if let Some(fates) = fates {
            let displaced = fates.overwritten.saturating_add(fates.discarded);
            now.displaced = now.displaced.max(displaced);
            for fate in GapReason::unsent() {
                let count = fates.of(fate);
                // The publisher counts those that expired at either side together.
                let unsent = match fate {
                    Fate::Expired => count.saturating_sub(now.expired_taken),
                    _ => count,
                };
                let known = now.unsent.of_mut(fate);
                *known = unsent.max(*known);
            }
        }
        let before = mem::replace(self, now);
        let unsent = GapReason::unsent().map(move |fate| Loss {
            reason: GapReason::Unsent(fate),
            messages: now.unsent.of(fate) - before.unsent.of(fate),
            is_shown: true,
        });
        let expired = Loss {
            reason: GapReason::Unsent(Fate::Expired),
            messages: now.expired_taken - before.expired_taken,
            is_shown: false,
        };
        Look {
            displaced: (now.displaced - before.displaced).saturating_add(now.away - before.away),
            losses: unsent.chain([expired]),
        }
    }
}
