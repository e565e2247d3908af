//! Deadlines that publishers and subscribers missed.

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
        let found = of.iter().filter_map(|&interface| {
            let periods = sample.interface(view.domain, interface)?.missed_deadlines;
            (periods > 0).then(|| Self {
                interface: view.title(interface),
                periods,
            })
        });
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
