//! The limits of a spool.

use std::time::Duration;

use sm2_proto::Instant;

const SECOND_NS: u128 = 1_000_000_000;
const RETRY: Duration = Duration::from_secs(10);

/// The limits of a [`Spool`](super::Spool).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Limits {
    max_bytes: u64,
    window_bytes: u64,
    max_age: Option<Duration>,
    rate_bytes_per_s: Option<u64>,
    retry: Duration,
}

/// The reason why values are not the limits of a spool.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LimitsError {
    /// A value is zero.
    #[error("the limit `{0}` of a spool is at least 1")]
    Zero(&'static str),
    /// Messages in flight would not fit into the spool when the network goes away.
    #[error("`window_bytes` ({window_bytes}) is at most `max_bytes` ({max_bytes})")]
    Window {
        /// The bytes in flight at most.
        window_bytes: u64,
        /// The spooled bytes at most.
        max_bytes: u64,
    },
}

impl Limits {
    /// A spool for at most `max_bytes`, with at most `window_bytes` of them in flight. Messages that are longer than
    /// `window_bytes` are refused.
    ///
    /// # Errors
    ///
    /// A value is zero, or the window is larger than the spool.
    pub const fn new(max_bytes: u64, window_bytes: u64) -> Result<Self, LimitsError> {
        if window_bytes == 0 {
            return Err(LimitsError::Zero("window_bytes"));
        }
        if window_bytes > max_bytes {
            return Err(LimitsError::Window {
                window_bytes,
                max_bytes,
            });
        }
        Ok(Self {
            max_bytes,
            window_bytes,
            max_age: None,
            rate_bytes_per_s: None,
            retry: RETRY,
        })
    }

    /// Messages that are older expire. Without it, they wait as long as there is room.
    #[must_use]
    pub const fn with_max_age(mut self, max_age: Duration) -> Self {
        self.max_age = Some(max_age);
        self
    }

    /// At most this many bytes are sent in a second, after a first window, so that the end of a long outage is not
    /// followed by a flood. Without it, only the window limits sending.
    ///
    /// # Errors
    ///
    /// The rate is zero.
    pub const fn with_rate(mut self, rate_bytes_per_s: u64) -> Result<Self, LimitsError> {
        if rate_bytes_per_s == 0 {
            return Err(LimitsError::Zero("rate_bytes_per_s"));
        }
        self.rate_bytes_per_s = Some(rate_bytes_per_s);
        Ok(self)
    }

    /// A message that is not acknowledged for this long is sent again, and so are those after it. It is 10 s without
    /// this option.
    #[must_use]
    pub const fn with_retry(mut self, retry: Duration) -> Self {
        self.retry = retry;
        self
    }

    pub(super) const fn max_bytes(&self) -> u64 {
        self.max_bytes
    }

    pub(super) const fn window_bytes(&self) -> u64 {
        self.window_bytes
    }

    pub(super) const fn max_age(&self) -> Option<Duration> {
        self.max_age
    }

    pub(super) const fn retry(&self) -> Duration {
        self.retry
    }

    /// The time when `len` bytes more are paid by the rate.
    pub(super) fn pay(&self, paid_until: Instant, len: u64) -> Instant {
        match self.rate_bytes_per_s {
            Some(rate) => paid_until.after(cost(len, rate)),
            None => paid_until,
        }
    }

    /// The earliest time when `len` bytes may be sent: a window ahead of the rate at most.
    pub(super) fn earliest(&self, paid_until: Instant, len: u64) -> Instant {
        match self.rate_bytes_per_s {
            Some(rate) => {
                let ahead =
                    u64::try_from(cost(self.window_bytes, rate).as_nanos()).unwrap_or(u64::MAX);
                Instant(self.pay(paid_until, len).0.saturating_sub(ahead))
            }
            None => paid_until,
        }
    }
}

/// The time that `len` bytes take at a rate, rounded up.
fn cost(len: u64, rate_bytes_per_s: u64) -> Duration {
    let ns = (u128::from(len) * SECOND_NS).div_ceil(u128::from(rate_bytes_per_s));
    Duration::from_nanos(u64::try_from(ns).unwrap_or(u64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_fits_into_its_spool() {
        assert_eq!(Limits::new(1, 0), Err(LimitsError::Zero("window_bytes")));
        assert_eq!(
            Limits::new(1, 2),
            Err(LimitsError::Window {
                window_bytes: 2,
                max_bytes: 1,
            })
        );
        let limits = Limits::new(1, 1).unwrap();
        assert_eq!(
            limits.with_rate(0),
            Err(LimitsError::Zero("rate_bytes_per_s"))
        );
    }

    #[test]
    fn sending_runs_ahead_of_the_rate_by_a_window() {
        let limits = Limits::new(1_000, 100).unwrap().with_rate(10).unwrap();
        let start = Instant(1 << 40);
        let second = |count: u64| start.after(Duration::from_secs(count));
        assert!(limits.earliest(start, 100) <= start);
        let paid = limits.pay(start, 100);
        assert_eq!(paid, second(10));
        assert_eq!(limits.earliest(paid, 20), second(2));
    }
}
