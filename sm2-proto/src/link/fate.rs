//! The fates of messages, and their counts.

/// How a message was settled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Fate {
    /// Released as consumed: the application took it.
    Delivered,
    /// Displaced by a later message before it left this side.
    Overwritten,
    /// Displaced by a later message on the other side.
    Discarded,
    /// Never sent, because a deadline passed. Appears only in the counters: see `Input::Skip`.
    Deadline,
    /// Not settled when the link ended.
    Closed,
    /// Longer than the other end accepts, which was not known when the message was queued: its OPEN
    /// came later.
    TooLong,
    /// Older than its lifespan before the application took it.
    Expired,
}

/// Counts of all messages of one link, by outcome: `offered = delivered + overwritten + discarded +
/// deadline + closed + pool_limit + too_long + expired + in_flight`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Counters {
    /// Every message that was passed to `send`, and every `Input::Skip`, `Input::PassOver`,
    /// `Input::PoolLimit`, `Input::TooLong` and `Input::Expired`.
    pub offered: u64,
    /// See [`Fate::Delivered`].
    pub delivered: u64,
    /// See [`Fate::Overwritten`].
    pub overwritten: u64,
    /// See [`Fate::Discarded`].
    pub discarded: u64,
    /// See [`Fate::Deadline`].
    pub deadline: u64,
    /// See [`Fate::Closed`].
    pub closed: u64,
    /// Not sent on this link because of the publisher's pool limit: see `Input::PoolLimit`.
    pub pool_limit: u64,
    /// Not sent on this link because the other end does not accept messages of this length: see
    /// `Input::TooLong` and [`Fate::TooLong`].
    pub too_long: u64,
    /// Older than its lifespan before it was sent, or before the other end took it: see `Input::Expired` and
    /// [`Fate::Expired`].
    pub expired: u64,
    /// Queued on this side, or sent and not yet released.
    pub in_flight: u64,
}

impl Counters {
    /// The messages that were dropped, for any reason.
    #[must_use]
    #[inline]
    pub const fn dropped(&self) -> u64 {
        self.overwritten
            .saturating_add(self.discarded)
            .saturating_add(self.deadline)
            .saturating_add(self.closed)
            .saturating_add(self.pool_limit)
            .saturating_add(self.too_long)
            .saturating_add(self.expired)
    }
}
