//! How the messages of a topic are sent.

use core::{
    num::{NonZeroU32, NonZeroU64},
    time::Duration,
};

use crate::Instant;

/// The greatest [`SendQos::priority`].
pub const PRIORITY_MAX: u8 = 7;

const NANOS_PER_S: u64 = 1_000_000_000;

/// How the messages of one topic are sent to a peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SendQos {
    /// How many messages are queued at most, besides the one in flight; 0 counts as 1.
    pub depth: u16,
    /// The weight of the topic: each step, up to [`PRIORITY_MAX`], doubles its share.
    pub priority: u8,
    /// The greatest rate of messages.
    pub messages_per_s: Option<NonZeroU32>,
    /// The greatest rate of bytes, averaged over messages.
    pub bytes_per_s: Option<NonZeroU64>,
    /// The greatest age, since publication, of a message that starts.
    pub max_age: Option<Duration>,
}

impl SendQos {
    pub(super) fn depth(&self) -> usize {
        usize::from(self.depth.max(1))
    }

    /// By how much a message advances the virtual time of its topic: its length divided by the
    /// weight of the topic, in units of the greatest weight.
    pub(super) fn virtual_len(&self, len_bytes: u64) -> u64 {
        let steps_below_max = PRIORITY_MAX - self.priority.min(PRIORITY_MAX);
        len_bytes.max(1).saturating_mul(1 << steps_below_max)
    }

    /// How long the rate limits make a topic wait after a message.
    pub(super) fn interval(&self, len_bytes: u64) -> Duration {
        let by_messages = self
            .messages_per_s
            .map_or(0, |it| NANOS_PER_S / u64::from(it.get()));
        let by_bytes = self.bytes_per_s.map_or(0, |it| {
            let nanos = u128::from(len_bytes) * u128::from(NANOS_PER_S) / u128::from(it.get());
            u64::try_from(nanos).unwrap_or(u64::MAX)
        });
        Duration::from_nanos(by_messages.max(by_bytes))
    }

    pub(super) fn is_expired(&self, published_at: Instant, now: Instant) -> bool {
        self.expires_at(published_at).is_some_and(|at| at <= now)
    }

    /// The first time when a message is too old to start.
    pub(super) fn expires_at(&self, published_at: Instant) -> Option<Instant> {
        let max_age_ns = u64::try_from(self.max_age?.as_nanos()).ok()?;
        let last = published_at.0.checked_add(max_age_ns)?;
        last.checked_add(1).map(Instant)
    }
}
