//! How long the publications of one publisher may wait for its reliable links.
//!
//! A wait delays the next message of all other subscribers, so its length must not depend on what a subscriber does. A
//! limit for each wait, or for each link, does not bound the sum: a subscriber that releases one message each 20 ms
//! starts a new wait each time, and ten subscribers have ten limits. All waits of a publisher therefore share one
//! budget. Its burst is one timeout, so that the publisher waits in full for a subscriber that is briefly behind. The
//! messages of a program that calls `wait_for_room` are not limited, because the program chooses this wait.

use core::time::Duration;

use crate::Instant;

/// The time that the publications of one publisher may wait for reliable links: a token bucket.
///
/// The bucket holds at most the *burst*, which is the longest timeout of a publication so far. It gains the *share* of
/// the time that passes. In any period, the publisher therefore waits for at most the burst and the share of the
/// period, whatever its peers do. With a share of 100 % the bucket always holds the burst, so it limits nothing.
///
/// | state | [`grant`](Self::grant) with a timeout | [`charge`](Self::charge) of the grant |
/// | --- | --- | --- |
/// | the bucket holds the timeout or more | the timeout | gives back what was not waited |
/// | it holds less | what it holds | the same |
/// | it is empty | nothing: the publication does not wait | no change |
///
/// The caller takes a grant only if a link without room does not owe ([`Link::owes`](crate::link::Link::owes)), so a
/// publication that waits for nobody costs nothing here.
//= SM2-QOS-004
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct WaitBudget {
    share_percent: u8,
    /// In units of a hundredth of a nanosecond, so that no share of a nanosecond is lost.
    left: u128,
    burst: u128,
    /// The time when `left` was true.
    updated: Instant,
    waited_ns: u64,
}

/// A wait that [`WaitBudget::grant`] allows.
#[derive(Debug, PartialEq, Eq)]
#[must_use = "a grant that is not charged counts as waited in full"]
pub struct WaitGrant {
    since: Instant,
    until: Instant,
}

impl WaitBudget {
    /// The share of a publisher that sets none, in per cent of the time.
    pub const SHARE_DEFAULT_PERCENT: u8 = 1;

    /// A full bucket. A share above 100 counts as 100.
    #[must_use]
    pub const fn new(share_percent: u8) -> Self {
        Self {
            share_percent: if share_percent > 100 {
                100
            } else {
                share_percent
            },
            left: 0,
            burst: 0,
            updated: Instant(0),
            waited_ns: 0,
        }
    }

    /// How long a publication with this timeout may wait.
    pub fn grant(&mut self, now: Instant, timeout: Duration) -> WaitGrant {
        self.gain(now);
        let asked = hundredths(timeout);
        if asked > self.burst {
            self.left += asked - self.burst;
            self.burst = asked;
        }
        let ns = asked.min(self.left) / 100;
        self.left -= ns * 100;
        let ns = u64::try_from(ns).unwrap_or(u64::MAX);
        let until = Instant(now.0.saturating_add(ns));
        self.waited_ns = self.waited_ns.saturating_add(until.0 - now.0);
        WaitGrant { since: now, until }
    }

    /// The wait has ended. Gives back what was not waited.
    pub fn charge(&mut self, grant: WaitGrant, now: Instant) {
        self.gain(now);
        let unused = grant.until.since(grant.since.max(now));
        self.left = (self.left + hundredths(unused)).min(self.burst);
        let unused_ns = u64::try_from(unused.as_nanos()).unwrap_or(u64::MAX);
        self.waited_ns = self.waited_ns.saturating_sub(unused_ns);
    }

    /// How long publications have waited. A grant that is not charged counts in full.
    #[must_use]
    pub const fn waited(&self) -> Duration {
        Duration::from_nanos(self.waited_ns)
    }

    /// Adds the share of the time since the last call.
    fn gain(&mut self, now: Instant) {
        let passed = now.0.saturating_sub(self.updated.0);
        let gained = u128::from(passed) * u128::from(self.share_percent);
        self.left = (self.left + gained).min(self.burst);
        self.updated = self.updated.max(now);
    }
}

impl WaitGrant {
    /// The time when the wait ends at the latest.
    #[must_use]
    pub const fn until(&self) -> Instant {
        self.until
    }

    /// Whether the publication may not wait at all.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.until.0 <= self.since.0
    }
}

fn hundredths(time: Duration) -> u128 {
    u128::from(u64::try_from(time.as_nanos()).unwrap_or(u64::MAX)) * 100
}
