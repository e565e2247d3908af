//! The counters of some nodes, and how they change within a second.

use std::{collections::BTreeSet, time::Duration};

use sm2_io::clock;
use sm2_node::Node;
use sm2_proto::{Instant, NodeId, counters::Entry, domain::Domain};

use crate::{
    error::CliError,
    sampling::{Sample, Sampler},
};

/// The time between the two readings.
const WINDOW: Duration = Duration::from_secs(1);

/// One reading of counters, and an earlier one if there is one.
#[derive(Debug)]
pub(crate) struct Observation {
    before: Option<Sample>,
    now: Sample,
}

/// The readings of an [`Observation`], or those of a command that reads counters all the time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Readings<'s> {
    pub(crate) before: Option<&'s Sample>,
    pub(crate) now: &'s Sample,
}

impl Observation {
    /// Reads the counters of these nodes. If messages were dropped or deadlines missed at some time, reads them again
    /// a second later, so that it is known whether that still happens. `wait` waits until that time, and returns
    /// false if there is to be no second reading.
    ///
    /// # Errors
    ///
    /// [`CliError::Query`], and the errors of `wait`.
    pub(crate) fn make(
        node: &Node,
        domain: &Domain,
        wanted: &BTreeSet<NodeId>,
        wait: impl FnOnce(Instant) -> Result<bool, CliError>,
    ) -> Result<Self, CliError> {
        let mut sampler = Sampler::new();
        let first = sampler.look(node, domain, wanted)?;
        if !(first.has_losses() && wait(clock::now().after(WINDOW))?) {
            return Ok(Self::once(first));
        }
        let now = sampler.look(node, domain, wanted)?;
        let before = Some(first);
        Ok(Self { before, now })
    }

    /// A single reading.
    pub(crate) const fn once(now: Sample) -> Self {
        Self { before: None, now }
    }

    pub(crate) const fn readings(&self) -> Readings<'_> {
        Readings {
            before: self.before.as_ref(),
            now: &self.now,
        }
    }
}

impl Readings<'_> {
    /// The time between the two readings. `None` if there is only one.
    pub(crate) fn window(&self) -> Option<Duration> {
        let window = self.now.since(self.before?);
        (!window.is_zero()).then_some(window)
    }

    /// A growth between the two readings as a rate.
    pub(crate) fn per_s(&self, growth: Option<u64>) -> Option<f64> {
        Some(growth? as f64 / self.window()?.as_secs_f64())
    }

    /// The growth of a count between the two readings, if both have the entry.
    pub(crate) fn growth(
        &self,
        entry: impl Fn(&Sample) -> Option<&Entry>,
        count: impl Fn(&Entry) -> u64,
    ) -> Option<u64> {
        let before = count(entry(self.before?)?);
        count(entry(self.now)?).checked_sub(before)
    }
}
