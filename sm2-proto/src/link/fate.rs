//! The fates of messages, and their counts. Each fate has one name, and each sum over the fates is here.

use core::fmt;

/// The way in which a message of a link ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Fate {
    /// Released as consumed: the application took it.
    Delivered,
    /// Displaced by a later message before it left this side, or not sent for lack of a slot or of room.
    Overwritten,
    /// Displaced by a later message on the other side.
    Discarded,
    /// Not sent, because a deadline passed while a reliable publisher waited for room.
    Deadline,
    /// Not settled when the link ended.
    Closed,
    /// Not sent, because messages of this link take too much of the publisher's memory.
    PoolLimit,
    /// Longer than the other end accepts. When the message was queued, that may not have been known: OPEN came later.
    TooLong,
    /// Older than its lifespan before it was sent, or before the application at the other end took it.
    Expired,
}

impl Fate {
    /// All fates, in the order in which they are shown.
    pub const ALL: [Self; 8] = [
        Self::Delivered,
        Self::Overwritten,
        Self::Discarded,
        Self::Deadline,
        Self::Closed,
        Self::PoolLimit,
        Self::TooLong,
        Self::Expired,
    ];

    /// The name in SPEC, in counters and in JSON.
    //= SM2-QOS-006
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Delivered => "delivered",
            Self::Overwritten => "overwritten",
            Self::Discarded => "discarded",
            Self::Deadline => "deadline",
            Self::Closed => "closed",
            Self::PoolLimit => "pool_limit",
            Self::TooLong => "too_long",
            Self::Expired => "expired",
        }
    }

    /// Whether a message with this fate did not reach the application.
    #[must_use]
    #[inline]
    pub const fn is_drop(self) -> bool {
        !matches!(self, Self::Delivered)
    }

    /// Whether a driver can say so of a publication that it does not send on a link.
    pub(super) const fn is_unsent(self) -> bool {
        match self {
            Self::Overwritten
            | Self::Deadline
            | Self::PoolLimit
            | Self::TooLong
            | Self::Expired => true,
            Self::Delivered | Self::Discarded | Self::Closed => false,
        }
    }

    /// Whether the link of a publication that was not sent owes from then on.
    //= SM2-QOS-003
    pub(super) const fn incurs_debt(self) -> bool {
        matches!(self, Self::Deadline | Self::PoolLimit)
    }
}

impl fmt::Display for Fate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// Counts of all messages of one link, by fate. The messages offered are those of all fates and those in flight:
/// [`is_balanced`](Self::is_balanced).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Counters {
    /// Every message that was passed to [`send`](super::Link::send), and every publication that was
    /// [dropped](super::Input::Drop).
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
    /// See [`Fate::PoolLimit`].
    pub pool_limit: u64,
    /// See [`Fate::TooLong`].
    pub too_long: u64,
    /// See [`Fate::Expired`].
    pub expired: u64,
    /// Queued on this side, or sent and not yet released.
    pub in_flight: u64,
}

impl Counters {
    /// The number of messages with this fate.
    #[must_use]
    #[inline]
    pub const fn of(&self, fate: Fate) -> u64 {
        match fate {
            Fate::Delivered => self.delivered,
            Fate::Overwritten => self.overwritten,
            Fate::Discarded => self.discarded,
            Fate::Deadline => self.deadline,
            Fate::Closed => self.closed,
            Fate::PoolLimit => self.pool_limit,
            Fate::TooLong => self.too_long,
            Fate::Expired => self.expired,
        }
    }

    /// The number of messages with this fate, to change it.
    #[inline]
    pub const fn of_mut(&mut self, fate: Fate) -> &mut u64 {
        match fate {
            Fate::Delivered => &mut self.delivered,
            Fate::Overwritten => &mut self.overwritten,
            Fate::Discarded => &mut self.discarded,
            Fate::Deadline => &mut self.deadline,
            Fate::Closed => &mut self.closed,
            Fate::PoolLimit => &mut self.pool_limit,
            Fate::TooLong => &mut self.too_long,
            Fate::Expired => &mut self.expired,
        }
    }

    /// The messages that were dropped, for any reason.
    #[must_use]
    #[inline]
    pub fn dropped(&self) -> u64 {
        let drops = Fate::ALL.into_iter().filter(|it| it.is_drop());
        drops.fold(0, |sum, fate| sum.saturating_add(self.of(fate)))
    }

    /// Whether each message that was offered has one fate or is in flight.
    //= SM2-QOS-006
    #[must_use]
    pub fn is_balanced(&self) -> bool {
        let settled = self.delivered.saturating_add(self.dropped());
        self.offered == settled.saturating_add(self.in_flight)
    }

    /// Adds the counts of another link.
    pub fn add(&mut self, other: &Self) {
        self.offered += other.offered;
        self.in_flight += other.in_flight;
        for fate in Fate::ALL {
            *self.of_mut(fate) += other.of(fate);
        }
    }

    /// Counts a publication that is not sent.
    pub(super) const fn drop_publication(&mut self, fate: Fate) {
        self.offered += 1;
        *self.of_mut(fate) += 1;
    }
}
