//! Statistics: medians of runs, and percentiles of durations.

use serde::{Deserialize, Serialize};

/// The median and the range of several runs.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// The median; for an even number of runs, the mean of the two in the middle.
    pub median: f64,
    /// The least value.
    pub min: f64,
    /// The greatest value.
    pub max: f64,
}

/// The summary of runs; `None` if there are none.
#[must_use]
pub fn summary(runs: &[f64]) -> Option<Summary> {
    let mut sorted = runs.to_vec();
    sorted.sort_by(f64::total_cmp);
    let (min, max) = (*sorted.first()?, *sorted.last()?);
    let middle = sorted.len() / 2;
    let median = if sorted.len() % 2 == 1 {
        sorted[middle]
    } else {
        f64::midpoint(sorted[middle - 1], sorted[middle])
    };
    Some(Summary { median, min, max })
}

/// Durations of one run, in nanoseconds.
#[derive(Clone, Debug, Default)]
pub struct Durations(Vec<u64>);

/// Statistics of durations, in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// The number of durations.
    pub count: u64,
    /// The mean.
    pub mean: f64,
    /// The median.
    pub p50: f64,
    /// The 99th percentile.
    pub p99: f64,
    /// The longest duration.
    pub max: f64,
}

impl Durations {
    /// An empty list with room for this many durations.
    #[must_use]
    pub fn with_capacity(count: usize) -> Self {
        Self(Vec::with_capacity(count))
    }

    /// Adds a duration.
    pub fn record(&mut self, duration_ns: u64) {
        self.0.push(duration_ns);
    }

    /// Removes all durations.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// The statistics; all zero if there are no durations.
    #[must_use]
    pub fn spread(mut self) -> Spread {
        let Some(last) = self.0.len().checked_sub(1) else {
            return Spread::default();
        };
        self.0.sort_unstable();
        // The nearest rank: a percentile is one of the durations.
        let rank = |percent: usize| self.0[((last + 1) * percent).div_ceil(100).max(1) - 1] as f64;
        let sum: u128 = self.0.iter().map(|&ns| u128::from(ns)).sum();
        Spread {
            count: self.0.len() as u64,
            mean: sum as f64 / self.0.len() as f64,
            p50: rank(50),
            p99: rank(99),
            max: self.0[last] as f64,
        }
    }
}

#[cfg(test)]
mod tests;
