//! How long to wait before each attempt to connect.

use core::time::Duration;

/// The longest that the first wait can be.
const FIRST: Duration = Duration::from_millis(10);

/// Waits that double up to a longest one, each of them random.
//= SM2-RES-001
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Backoff {
    /// The longest that any wait can be.
    most: Duration,
    /// The longest that the next wait can be.
    longest: Duration,
    random: u64,
}

impl Backoff {
    /// Before the first attempt. `seed`: another one for each who waits; `most`: the longest wait
    /// of all, 10 ms or more.
    #[must_use]
    pub const fn new(seed: u64, most: Duration) -> Self {
        Self {
            most,
            longest: FIRST,
            random: seed,
        }
    }

    /// There was a connection for so long. Two sides that do not get along must not greet each
    /// other as often as they can: one that ends before the longest wait counts as one more attempt.
    pub fn ended_after(&mut self, connection: Duration) {
        if connection >= self.most {
            self.longest = FIRST;
        }
    }

    /// The first time anything up to 10 ms: all who wait for one may have lost it at the same
    /// moment. Then twice as long each time, and never less than half of that.
    #[must_use]
    pub fn wait(&mut self) -> Duration {
        let longest = self.longest;
        self.longest = (longest * 2).min(self.most);
        let shortest = if longest == FIRST {
            Duration::ZERO
        } else {
            longest / 2
        };
        shortest + self.random_up_to(longest - shortest)
    }

    /// Anything from zero to this.
    pub(crate) fn random_up_to(&mut self, most: Duration) -> Duration {
        let span_ns = u64::try_from(most.as_nanos()).unwrap_or(u64::MAX - 1);
        Duration::from_nanos(self.random() % (span_ns + 1))
    }

    /// SplitMix64.
    pub(crate) const fn random(&mut self) -> u64 {
        self.random = self.random.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.random;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
}
