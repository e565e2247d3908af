//! What the processes of the demo cost together.

use std::time::{Duration, Instant};

use crate::process_cost;

/// What one process costs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Cost {
    /// Of one processor, since the last look.
    pub(crate) cpu_percent: f64,
    /// Its share of the memory that it maps; none if this user may not know.
    pub(crate) pss_bytes: Option<u64>,
}

/// Looks at processes again and again, from [`start`](Meter::start) on.
#[derive(Debug)]
pub(crate) struct Meter {
    pids: Vec<u32>,
    started: Instant,
    looked: Instant,
    at_start: Vec<Duration>,
    at_look: Vec<Duration>,
    pss_bytes_max: Option<u64>,
}

/// What all processes cost from the start to the last look.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Total {
    /// Of one processor: 200 are two whole ones.
    pub(crate) cpu_percent: f64,
    /// The most that it was at a look.
    pub(crate) pss_bytes: Option<u64>,
    /// From the start to the last look.
    pub(crate) wall: Duration,
}

impl Meter {
    pub(crate) fn start(pids: Vec<u32>) -> Self {
        let now = Instant::now();
        let times: Vec<_> = pids.iter().map(|&pid| cpu_time(pid, None)).collect();
        Self {
            pids,
            started: now,
            looked: now,
            at_start: times.clone(),
            at_look: times,
            pss_bytes_max: None,
        }
    }

    /// The costs of each process, in the order of the pids.
    pub(crate) fn look(&mut self) -> Vec<Cost> {
        let now = Instant::now();
        let passed = now - self.looked;
        self.looked = now;
        let processes = self.pids.iter().zip(&mut self.at_look);
        let costs: Vec<Cost> = processes
            .map(|(&pid, before)| {
                let used = cpu_time(pid, Some(*before));
                let cpu_percent = percent(used.saturating_sub(*before), passed);
                *before = used;
                Cost {
                    cpu_percent,
                    pss_bytes: process_cost::pss_bytes(pid),
                }
            })
            .collect();
        // Those who have ended map nothing any more.
        let pss_bytes = costs.iter().filter_map(|cost| cost.pss_bytes).sum::<u64>();
        if pss_bytes > 0 {
            self.pss_bytes_max = self.pss_bytes_max.max(Some(pss_bytes));
        }
        costs
    }

    pub(crate) fn elapsed(&self) -> Duration {
        self.started.elapsed()
    }

    /// As of the last look.
    pub(crate) fn total(&self) -> Total {
        let used: Duration = self.at_look.iter().sum();
        let before: Duration = self.at_start.iter().sum();
        let wall = self.looked - self.started;
        Total {
            cpu_percent: percent(used.saturating_sub(before), wall),
            pss_bytes: self.pss_bytes_max,
            wall,
        }
    }
}

/// A process that is gone keeps the time that it had.
fn cpu_time(pid: u32, before: Option<Duration>) -> Duration {
    process_cost::cpu_time(pid).or(before).unwrap_or_default()
}

fn percent(used: Duration, of: Duration) -> f64 {
    match of.as_secs_f64() {
        0.0 => 0.0,
        seconds => 100.0 * used.as_secs_f64() / seconds,
    }
}
