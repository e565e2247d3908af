//! `sm2 topic bw`: the bandwidth of published messages.

use serde::Serialize;
use sm2_proto::Kind;

use super::measure::{Look, Measure, help};
use crate::{
    columns::{self, Column, number},
    sampling::hundredths,
};

pub(super) const HELP: &str = help!(
    "\
A message counts once, whatever the number of its subscribers. MEAN SIZE is the mean size of the
messages in the interval.",
    "  sm2 topic bw camera
  sm2 topic bw camera --interval 5s --count 1 --json"
);

/// A publisher.
#[derive(Serialize)]
pub(super) struct Row {
    node: String,
    interface: u64,
    /// The number of messages since the publisher was declared.
    messages: u64,
    /// The number of bytes since the publisher was declared.
    bytes: u64,
    /// The rate in the interval. `None` for a publisher that came during the interval.
    bytes_per_s: Option<f64>,
    /// The mean size in the interval. `None` if no message was published.
    mean_size_bytes: Option<f64>,
}

impl columns::Row for Row {
    const COLUMNS: &'static [Column<Self>] = &[
        ("PUBLISHER", |it| it.node.clone()),
        ("MB/s", |it| {
            number(it.bytes_per_s.map(|bytes| bytes / 1e6), 6)
        }),
        ("MEAN SIZE", |it| number(it.mean_size_bytes, 0)),
        ("MESSAGES", |it| it.messages.to_string()),
        ("BYTES", |it| it.bytes.to_string()),
    ];
}

impl Measure for Row {
    const ROLE: &str = "bw";
    const OF: Kind = Kind::Publisher;
    const ROWS: &str = "publishers";
    const TEXTS: usize = 1;

    fn rows(look: &Look<'_>) -> Vec<Self> {
        look.of_interfaces(|entity, entry| {
            let rate = look.rate(entity);
            let moving = rate.filter(|rate| rate.messages_per_s > 0.0);
            Self {
                node: look.view.name_of(entity.node).to_owned(),
                interface: entity.interface.0,
                messages: entry.messages,
                bytes: entry.bytes,
                bytes_per_s: rate.map(|rate| hundredths(rate.bytes_per_s)),
                mean_size_bytes: moving.map(|it| hundredths(it.bytes_per_s / it.messages_per_s)),
            }
        })
    }
}
