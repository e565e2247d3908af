//! The losses of a link, as its two ends count them.

use std::mem;

use sm2_node::diagnostics::{Counters, Received};
use sm2_proto::link::Fate;

use crate::gap::GapReason;

/// The losses on a link that are known so far.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Known {
    /// Messages that were not sent, by [`GapReason::unsent`].
    unsent: Counters,
    /// Messages that were displaced at the publisher, those that were displaced at the recorder, and those that were
    /// published while their publisher had no link. The number of the next message shows that they are missing, and the
    /// recorder counts them then.
    overwritten: u64,
    discarded: u64,
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
    /// Takes over what the recorder has received on a link, and the fates of its messages if they are known. Returns
    /// what is new.
    pub(super) fn advance(
        &mut self,
        received: &Received,
        fates: Option<&Counters>,
    ) -> Look<impl Iterator<Item = Loss> + use<>> {
        let mut now = *self;
        now.expired_taken = now.expired_taken.max(received.expired);
        now.away = now.away.max(received.away);
        // On the socket lane, the publisher learns it later, and only if it calls its node.
        now.discarded = now.discarded.max(received.discarded);
        if let Some(fates) = fates {
            now.overwritten = now.overwritten.max(fates.overwritten);
            now.discarded = now.discarded.max(fates.discarded);
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
        let displaced = [
            now.overwritten - before.overwritten,
            now.discarded - before.discarded,
            now.away - before.away,
        ];
        Look {
            displaced: displaced.into_iter().fold(0, u64::saturating_add),
            losses: unsent.chain([expired]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_that_either_side_displaced_are_counted_once() {
        let mut known = Known::default();
        // Messages that the recorder displaced, those of them that the publisher knows, and those that it displaced.
        for (here, there, overwritten, expected) in
            [(5, 0, 0, 5), (5, 3, 2, 2), (5, 5, 2, 0), (5, 7, 2, 2)]
        {
            let received = Received {
                discarded: here,
                ..Received::default()
            };
            let fates = Counters {
                discarded: there,
                overwritten,
                ..Counters::default()
            };
            let look = known.advance(&received, Some(&fates));
            assert_eq!(look.displaced, expected, "{here} {there} {overwritten}");
        }
    }
}
