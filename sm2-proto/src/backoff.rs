//! The wait before each attempt to connect.

use core::time::Duration;

/// The upper bound of the first wait.
const FIRST: Duration = Duration::from_millis(10);

/// Random waits whose upper bound doubles with each attempt, up to a limit.
//= SM2-RES-001
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Backoff {
    /// The upper bound of every wait.
    most: Duration,
    /// The upper bound of the next wait.
    longest: Duration,
    random: u64,
}

impl Backoff {
    /// The waits before the first attempt. `seed` has to differ between processes; `most` is the
    /// upper bound of every wait, at least 10 ms.
    #[must_use]
    pub const fn new(seed: u64, most: Duration) -> Self {
        Self {
            most,
            longest: FIRST,
            random: seed,
        }
    }

    /// Notes that a connection lasted for this long. A connection that ended before the longest
    /// wait counts as one more failed attempt, so that two sides that reject each other do not
    /// reconnect at full speed.
    pub fn ended_after(&mut self, connection: Duration) {
        if connection >= self.most {
            self.longest = FIRST;
        }
    }

    /// The next wait. The first wait is random between zero and 10 ms, because many processes may
    /// have lost their connection at the same moment. Later waits double, and are random between
    /// half and all of their upper bound.
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

    /// A random number from zero to this one.
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
