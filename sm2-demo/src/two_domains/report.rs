//! The report of the demo with two domains.

use serde::Serialize;
use sm2_lossy_link::LossyLink;
use sm2_proto::Instant;

use super::traffic::Seen;
use crate::options::Ending;
use crate::statistics::{hundredths, nearest_rank};

/// The object that `--json` prints last.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Report {
    pub(crate) local: Local,
    pub(crate) remote: Remote,
    pub(crate) link: LinkReport,
    /// True if Ctrl-C ended the run early.
    pub(crate) interrupted: bool,
}

impl Report {
    /// Computes the figures of both subscribers before the remote one joined, and after.
    pub(crate) fn new(
        size_bytes: u64,
        link: &LossyLink,
        [before, after]: [Window; 2],
        local: &[Seen],
        away: &[Seen],
    ) -> Self {
        let hz = after.hz(away);
        Self {
            local: Local {
                hz_before: before.hz(local),
                hz_after: after.hz(local),
                p99_us_before: hundredths(before.age(local, 99) / 1e3),
                p99_us_after: hundredths(after.age(local, 99) / 1e3),
                lost: lost(local),
                damaged: damaged(local),
            },
            remote: Remote {
                hz,
                goodput_mbit: hundredths(hz * 8e-6 * size_bytes as f64),
                age_ms: Age {
                    p50: hundredths(after.age(away, 50) / 1e6),
                    p99: hundredths(after.age(away, 99) / 1e6),
                },
                damaged: damaged(away),
            },
            link: LinkReport {
                rate_mbit: link.profile().rate_bit / 1e6,
                loss_percent: f64::from(link.profile().loss_permille) / 10.0,
                kind: link.kind().as_str(),
            },
            interrupted: false,
        }
    }

    /// The end of the run. A damaged message is a bad result, and so is a link that no message passed.
    pub(crate) fn ending(&self) -> Ending {
        let is_damaged = self.local.damaged > 0 || self.remote.damaged > 0;
        match self.interrupted {
            true => Ending::Stopped,
            false if is_damaged || self.remote.hz == 0.0 => Ending::Bad,
            false => Ending::Complete,
        }
    }
}

/// The subscriber beside the publisher.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Local {
    /// Messages per second before the remote subscriber joined, and after.
    pub(crate) hz_before: f64,
    pub(crate) hz_after: f64,
    /// The 99th percentile of the latency from publishing to receiving, before and after.
    pub(crate) p99_us_before: f64,
    pub(crate) p99_us_after: f64,
    /// The number of messages that never arrived.
    pub(crate) lost: u64,
    /// The number of messages with a wrong byte.
    pub(crate) damaged: u64,
}

/// The subscriber behind the link.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Remote {
    pub(crate) hz: f64,
    pub(crate) goodput_mbit: f64,
    pub(crate) age_ms: Age,
    pub(crate) damaged: u64,
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct Age {
    pub(crate) p50: f64,
    pub(crate) p99: f64,
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct LinkReport {
    pub(crate) rate_mbit: f64,
    pub(crate) loss_percent: f64,
    /// `namespaces` or `relay`.
    pub(crate) kind: &'static str,
}

/// A part of the run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Window {
    pub(crate) from: Instant,
    pub(crate) to: Instant,
}

impl Window {
    fn of<'a>(&self, seen: &'a [Seen]) -> impl Iterator<Item = &'a Seen> + use<'a> {
        let Self { from, to } = *self;
        seen.iter().filter(move |it| from <= it.at && it.at < to)
    }

    pub(crate) fn seconds(&self) -> f64 {
        self.to.since(self.from).as_secs_f64()
    }

    pub(crate) fn hz(&self, seen: &[Seen]) -> f64 {
        match self.seconds() {
            seconds if seconds > 0.0 => hundredths(self.of(seen).count() as f64 / seconds),
            _ => 0.0,
        }
    }

    /// A percentile of the ages of messages, in nanoseconds.
    pub(crate) fn age(&self, seen: &[Seen], percent: usize) -> f64 {
        let mut ages: Vec<u64> = self.of(seen).map(|it| it.age_ns).collect();
        ages.sort_unstable();
        nearest_rank(&ages, percent) as f64
    }
}

/// The number of messages with a wrong byte.
fn damaged(seen: &[Seen]) -> u64 {
    seen.iter().filter(|it| it.damaged).count() as u64
}

/// The number of messages that are missing between the first and the last one.
fn lost(seen: &[Seen]) -> u64 {
    let whole = || seen.iter().filter(|it| !it.damaged);
    match (whole().next(), whole().next_back()) {
        (Some(first), Some(last)) => {
            (last.number - first.number + 1).saturating_sub(whole().count() as u64)
        }
        _ => 0,
    }
}

#[cfg(test)]
mod tests;
