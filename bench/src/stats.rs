//! From samples to figures.

use serde::{Deserialize, Serialize};

/// The middle of several runs, and their range.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// The middle one; the mean of the two in the middle if their number is even.
    pub median: f64,
    /// The least.
    pub min: f64,
    /// The greatest.
    pub max: f64,
}

/// Of these runs; `None` of none.
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

/// What is said about durations, in nanoseconds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// How many there were.
    pub count: u64,
    /// Their mean.
    pub mean: f64,
    /// Half of them are not longer.
    pub p50: f64,
    /// 99 of 100 are not longer.
    pub p99: f64,
    /// The longest.
    pub max: f64,
}

impl Durations {
    /// Room for so many before memory is asked for.
    #[must_use]
    pub fn with_capacity(count: usize) -> Self {
        Self(Vec::with_capacity(count))
    }

    /// One more.
    pub fn record(&mut self, duration_ns: u64) {
        self.0.push(duration_ns);
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// What is said about them; all zero of none.
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
