//! The report of the demo: the object that `--json` prints, and the verdict.

use serde::Serialize;

use super::{
    child::{Outcome, Part, Stage},
    meter::Total,
    part::Figures,
};
use crate::{
    error::DemoError,
    output,
    statistics::{Percentiles, hundredths},
};

/// The report of a run. Its field names are part of the command's interface.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Report {
    /// The number of published messages.
    pub(crate) published: u64,
    /// The length of each message, in bytes.
    pub(crate) size_bytes: u64,
    /// `pooled` or `sealed`.
    pub(crate) integrity: &'static str,
    /// True if a signal ended the run before all messages were published.
    pub(crate) interrupted: bool,
    /// The results of each subscriber.
    pub(crate) subscribers: Vec<Subscriber>,
    /// Processor time of all processes, including the Manager, in percent of the wall time: 200 is two
    /// full processors.
    pub(crate) cpu_percent_total: f64,
    /// The largest measured sum of the proportional set sizes of all processes; null if they cannot be
    /// read.
    pub(crate) pss_bytes_total: Option<u64>,
    /// The time from the first message until all were received, in seconds.
    pub(crate) wall_s: f64,
}

/// The results of one subscriber.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Subscriber {
    /// The number of received messages.
    pub(crate) received: u64,
    /// The number of published messages that it has not received.
    pub(crate) lost: u64,
    /// The number of received messages that differ from the published ones.
    pub(crate) damaged: u64,
    /// Messages per second, from the first to the last.
    pub(crate) hz: f64,
    /// Latency from publishing to receiving, in microseconds.
    pub(crate) latency_us: Percentiles,
}

impl Report {
    pub(crate) fn new(
        size_bytes: u64,
        is_sealed: bool,
        outcomes: &[Outcome<'_>],
        total: Total,
        interrupted: bool,
    ) -> Self {
        let is_publisher = |it: &&Outcome<'_>| it.part == Part::Publisher;
        let publisher = outcomes.iter().filter(is_publisher);
        let published = publisher.map(|it| it.figures.messages).sum();
        let subscribers = outcomes.iter().filter(|it| !is_publisher(it));
        let subscribers = subscribers
            .map(|it| Subscriber::new(published, it.figures))
            .collect();
        Self {
            published,
            size_bytes,
            integrity: output::integrity(is_sealed),
            interrupted,
            subscribers,
            cpu_percent_total: hundredths(total.cpu_percent),
            pss_bytes_total: total.pss_bytes,
            wall_s: hundredths(total.wall.as_secs_f64()),
        }
    }
}

impl Subscriber {
    fn new(published: u64, figures: Figures) -> Self {
        Self {
            received: figures.messages,
            // All subscribers were linked before the first message, so that every message that is
            // missing is lost, including those after the last received one.
            lost: published.saturating_sub(figures.messages),
            damaged: figures.damaged,
            hz: figures.hz,
            latency_us: figures.latency_us,
        }
    }
}

/// Checks that the run is a success: no message was damaged, no process failed, and every subscriber
/// received a message.
///
/// # Errors
///
/// [`DemoError::Damaged`], [`DemoError::PartFailed`], [`DemoError::NothingReceived`]; the first in this
/// order.
pub(crate) fn verdict(outcomes: &[Outcome<'_>]) -> Result<(), DemoError> {
    let checks = [damage, failure, nothing_received];
    let errors = checks
        .iter()
        .flat_map(|check| outcomes.iter().filter_map(|it| check(it)));
    errors.take(1).try_for_each(Err)
}

fn damage(outcome: &Outcome<'_>) -> Option<DemoError> {
    let spot = outcome.figures.first_damage?;
    Some(DemoError::Damaged {
        part: outcome.part.to_string(),
        messages: outcome.figures.damaged,
        message: spot.message,
        offset: spot.offset,
    })
}

fn failure(outcome: &Outcome<'_>) -> Option<DemoError> {
    let part = outcome.part.to_string();
    match outcome.stage {
        Stage::Done(_) => None,
        Stage::Failed(reason) => Some(DemoError::PartFailed {
            part,
            reason: reason.clone(),
        }),
        Stage::Starting | Stage::Ready => Some(DemoError::PartFailed {
            part,
            reason: "does not come to an end".into(),
        }),
    }
}

fn nothing_received(outcome: &Outcome<'_>) -> Option<DemoError> {
    let part = outcome.part.to_string();
    (outcome.figures.messages == 0).then_some(DemoError::NothingReceived { part })
}

#[cfg(test)]
mod tests;
