//! `sm2 topic hz`: the rate at which messages are published.

use serde::Serialize;
use sm2_proto::Kind;

use super::measure::{Look, Measure, cell, help};
use crate::{
    columns::{self, Column},
    sampling::{Millis, hundredths},
};

pub(super) const HELP: &str = help!(
    "\
HZ is the number of messages that each publisher published per second of the interval. The other
columns are the times between its last messages, up to 32 of them, in milliseconds.",
    "  sm2 topic hz scan
  sm2 topic hz scan --interval 200ms --count 5
  sm2 topic hz scan --json | jq '.publishers[].hz'"
);

/// A publisher.
#[derive(Serialize)]
pub(super) struct Row {
    node: String,
    interface: u64,
    /// The number of messages since the publisher was declared.
    messages: u64,
    /// The rate in the interval. `None` for a publisher that came during the interval.
    hz: Option<f64>,
    /// The times between its last messages. `None` for fewer than two messages.
    gap_ms: Option<Millis>,
}

impl Row {
    fn gap(&self, of: fn(&Millis) -> f64) -> String {
        cell(self.gap_ms.as_ref().map(of), 3)
    }
}

impl columns::Row for Row {
    const COLUMNS: &'static [Column<Self>] = &[
        ("PUBLISHER", |it| it.node.clone()),
        ("HZ", |it| cell(it.hz, 2)),
        ("MEAN ms", |it| it.gap(|gap| gap.mean)),
        ("MIN ms", |it| it.gap(|gap| gap.min)),
        ("MAX ms", |it| it.gap(|gap| gap.max)),
        ("STD DEV ms", |it| it.gap(|gap| gap.std_dev)),
        ("MESSAGES", |it| it.messages.to_string()),
    ];
}

impl Measure for Row {
    const ROLE: &str = "hz";
    const OF: Kind = Kind::Publisher;
    const ROWS: &str = "publishers";
    const TEXTS: usize = 1;

    fn rows(look: &Look<'_>) -> Vec<Self> {
        look.of_interfaces(|entity, entry| Self {
            node: look.view.name_of(entity.node).to_owned(),
            interface: entity.interface.0,
            messages: entry.messages,
            hz: look
                .rate(entity)
                .map(|rate| hundredths(rate.messages_per_s)),
            gap_ms: entry.gaps().map(Millis::from),
        })
    }
}
