//! `sm2 topic delay`: the delays of messages from publishing to receiving.

use serde::Serialize;
use sm2_proto::Kind;

use super::measure::{Look, Measure, help};
use crate::{
    columns::{self, Column, number},
    sampling::{median_ns, millis},
};

pub(super) const HELP: &str = help!(
    "\
The delay of a message is the time from publishing until the subscriber's program receives it, in
milliseconds. The figures cover up to 32 last messages of each link; WORST is the longest delay since
the link was made. A program that is slow to receive its messages has long delays. Figures in brackets
are old: the program received no message in the interval (`new_messages` is 0 in JSON).",
    "  sm2 topic delay scan
  sm2 topic delay scan --json | jq '.links[].p50_ms'"
);

/// The delays of one link.
#[derive(Serialize)]
pub(super) struct Row {
    publisher: String,
    subscriber: String,
    /// The number of messages that were received since the link was made.
    messages: u64,
    /// The number of messages that were received in the interval. 0: the other figures are old.
    new_messages: u64,
    /// The number of messages that the next three figures cover.
    recent: u32,
    mean_ms: Option<f64>,
    p50_ms: Option<f64>,
    max_ms: Option<f64>,
    /// The longest delay since the link was made.
    worst_ms: f64,
}

impl Row {
    /// A figure of the last messages, in brackets if they are old.
    fn recent(&self, value: Option<f64>) -> String {
        match self.new_messages {
            0 if value.is_some() => format!("({})", number(value, 3)),
            _ => number(value, 3),
        }
    }
}

impl columns::Row for Row {
    const COLUMNS: &'static [Column<Self>] = &[
        ("SUBSCRIBER", |it| it.subscriber.clone()),
        ("PUBLISHER", |it| it.publisher.clone()),
        ("MEAN ms", |it| it.recent(it.mean_ms)),
        ("P50 ms", |it| it.recent(it.p50_ms)),
        ("MAX ms", |it| it.recent(it.max_ms)),
        ("WORST ms", |it| number(Some(it.worst_ms), 3)),
        ("MESSAGES", |it| it.messages.to_string()),
    ];
}

impl Measure for Row {
    const ROLE: &str = "delay";
    const OF: Kind = Kind::Subscriber;
    const ROWS: &str = "links";
    const TEXTS: usize = 2;

    fn rows(look: &Look<'_>) -> Vec<Self> {
        look.of_links(|link| {
            let entry = look.now.demanding(look.view.domain, link)?;
            let before = look.before.demanding(look.view.domain, link);
            let before = before.map_or(0, |it| it.messages);
            let recent = entry.recent_delays();
            Some(Self {
                publisher: look.view.name_of(link.offering.node).to_owned(),
                subscriber: look.view.name_of(link.demanding.node).to_owned(),
                messages: entry.messages,
                new_messages: entry.messages.saturating_sub(before),
                recent: recent.map_or(0, |it| it.count),
                mean_ms: recent.map(|it| millis(it.mean_ns)),
                p50_ms: median_ns(entry).map(millis),
                max_ms: recent.map(|it| millis(it.max_ns)),
                worst_ms: millis(entry.delay_max_ns),
            })
        })
    }
}
