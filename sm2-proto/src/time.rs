//! Time as a value: drivers read the clock, machines only compare.

use core::time::Duration;

use serde::{Deserialize, Serialize};

/// A moment on the host's monotonic clock, in nanoseconds.
///
/// Every process of a domain reads the same clock (`CLOCK_MONOTONIC`), so two
/// moments taken by different processes of one machine can be compared.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct Instant(pub u64);

impl Instant {
    /// The moment `after` later; saturates at the end of time.
    #[must_use]
    pub fn after(self, after: Duration) -> Self {
        let nanos = u64::try_from(after.as_nanos()).unwrap_or(u64::MAX);
        Self(self.0.saturating_add(nanos))
    }

    /// The time from `earlier` to this moment; zero if `earlier` is later.
    #[must_use]
    pub fn since(self, earlier: Self) -> Duration {
        Duration::from_nanos(self.0.saturating_sub(earlier.0))
    }
}
