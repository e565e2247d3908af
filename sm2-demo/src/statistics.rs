//! Latencies and their percentiles.
//!
//! All values are kept, so the nearest rank is exact. A histogram is not.

use serde::{Deserialize, Serialize};
use sm2_proto::Instant;

/// All latencies of a run, which has at most [`MESSAGES_MAX`] messages.
#[derive(Clone, Debug, Default)]
pub(crate) struct Latencies {
    nanos: Vec<u64>,
    /// The index of the first latency of the current second.
    second: usize,
}

/// The largest number of messages of a run; 8 bytes are kept for each.
pub(crate) const MESSAGES_MAX: u64 = 1_000_000;

/// Percentiles of latencies, in microseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Percentiles {
    /// The median.
    pub(crate) p50: f64,
    /// The 99th percentile.
    pub(crate) p99: f64,
    /// The longest latency.
    pub(crate) max: f64,
}

impl Latencies {
    /// Adds the latency of a message.
    pub(crate) fn record(&mut self, nanos: u64) {
        self.nanos.push(nanos);
    }

    /// The percentiles of the latencies since the last call.
    pub(crate) fn take_second(&mut self) -> Percentiles {
        let second = &self.nanos[self.second..];
        self.second = self.nanos.len();
        Percentiles::of(second.to_vec())
    }

    /// The percentiles of all latencies.
    pub(crate) fn total(&self) -> Percentiles {
        Percentiles::of(self.nanos.clone())
    }
}

impl Percentiles {
    fn of(mut nanos: Vec<u64>) -> Self {
        nanos.sort_unstable();
        Self {
            p50: micros(nearest_rank(&nanos, 50)),
            p99: micros(nearest_rank(&nanos, 99)),
            max: micros(nearest_rank(&nanos, 100)),
        }
    }
}

/// The least value that `percent` of the values do not exceed; zero if there are none.
pub(crate) fn nearest_rank(sorted: &[u64], percent: usize) -> u64 {
    let rank = (sorted.len() * percent).div_ceil(100).max(1);
    sorted.get(rank - 1).copied().unwrap_or(0)
}

/// Microseconds, to the tenth.
fn micros(nanos: u64) -> f64 {
    nanos.div_ceil(100) as f64 / 10.0
}

/// Messages per second from the first to the last of `count`, to the hundredth.
pub(crate) fn rate(count: u64, first: Instant, last: Instant) -> f64 {
    let seconds = last.since(first).as_secs_f64();
    match count {
        2.. if seconds > 0.0 => hundredths((count - 1) as f64 / seconds),
        _ => 0.0,
    }
}

/// Rounded to two decimals.
pub(crate) fn hundredths(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

#[cfg(test)]
mod tests;
