//! The processor time and memory of all processes of the demo.

use std::time::{Duration, Instant};

use crate::process_cost;

/// The processor time and memory of one process.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Cost {
    /// Processor time since the last measurement, in percent of one processor.
    pub(crate) cpu_percent: f64,
    /// The proportional set size; `None` if this user may not read it.
    pub(crate) pss_bytes: Option<u64>,
}

/// Measures processes repeatedly, from [`start`](Meter::start) on.
#[derive(Debug)]
pub(crate) struct Meter {
    pids: Vec<u32>,
    started: Instant,
    looked: Instant,
    at_start: Vec<Duration>,
    at_look: Vec<Duration>,
    pss_bytes_max: Option<u64>,
}

/// The processor time and memory of all processes, from the start to the last measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Total {
    /// Processor time in percent of one processor: 200 is two full processors.
    pub(crate) cpu_percent: f64,
    /// The largest measured sum of proportional set sizes.
    pub(crate) pss_bytes: Option<u64>,
    /// The time from the start to the last measurement.
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

    /// Measures each process, in the order of the pids.
    pub(crate) fn measure(&mut self) -> Vec<Cost> {
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
        // Processes that have ended have no memory.
        let pss_bytes = costs.iter().filter_map(|cost| cost.pss_bytes).sum::<u64>();
        if pss_bytes > 0 {
            self.pss_bytes_max = self.pss_bytes_max.max(Some(pss_bytes));
        }
        costs
    }

    pub(crate) fn elapsed(&self) -> Duration {
        self.started.elapsed()
    }

    /// The totals at the last measurement.
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

/// The processor time of a process; the last known value if the process is gone.
fn cpu_time(pid: u32, before: Option<Duration>) -> Duration {
    process_cost::cpu_time(pid).or(before).unwrap_or_default()
}

fn percent(used: Duration, of: Duration) -> f64 {
    match of.as_secs_f64() {
        0.0 => 0.0,
        seconds => 100.0 * used.as_secs_f64() / seconds,
    }
}

#[cfg(test)]
mod tests;
