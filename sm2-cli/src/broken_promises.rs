//! Promises that publishers did not keep: deadlines and liveliness.

use std::fmt;

use serde::Serialize;
use sm2_proto::{EntityId, text::Counted};

use crate::{sampling::Sample, view::View};

/// A publisher that published nothing in some periods of its deadline, or a subscriber that got nothing.
#[derive(Serialize)]
pub(crate) struct MissedDeadlines {
    interface: String,
    /// The number of these periods.
    periods: u64,
}

impl MissedDeadlines {
    /// The interfaces among these that have missed deadlines.
    pub(crate) fn find(view: &View<'_>, sample: &Sample, of: &[EntityId]) -> Vec<Self> {
        let found = sample.counted(view, of, |entry| entry.missed_deadlines);
        let found = found.map(|(interface, periods)| Self { interface, periods });
        found.collect()
    }
}

/// `talker:scan missed its deadline in 2 periods`
impl fmt::Display for MissedDeadlines {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { interface, periods } = self;
        let periods = Counted::new(*periods, "period");
        write!(f, "{interface} missed its deadline in {periods}")
    }
}

/// A publisher that stopped being alive, or a subscriber with such publishers.
#[derive(Serialize)]
pub(crate) struct LostLiveliness {
    interface: String,
    /// How often this happened.
    times: u64,
}

impl LostLiveliness {
    /// The interfaces among these that have lost liveliness.
    pub(crate) fn find(view: &View<'_>, sample: &Sample, of: &[EntityId]) -> Vec<Self> {
        let found = sample.counted(view, of, |entry| entry.lost_liveliness);
        let found = found.map(|(interface, times)| Self { interface, times });
        found.collect()
    }
}

/// `talker:scan lost liveliness 2 times`
impl fmt::Display for LostLiveliness {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { interface, times } = self;
        let times = Counted::new(*times, "time");
        write!(f, "{interface} lost liveliness {times}")
    }
}
