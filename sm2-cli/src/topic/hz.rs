//! `sm2 topic hz`: the rate of publications.

use std::time::Duration;

use serde::Serialize;
use sm2_proto::{Kind, counters::Entry};

use super::measure::{Look, Measure, help};
use crate::{
    columns::{self, Column, number},
    sampling::{Millis, hundredths},
};

pub(super) const HELP: &str = help!(
    "\
HZ is the number of messages that each publisher published per second, over whole periods: from its last
message before the interval to its last message in the interval. The other columns are the times between
its last messages, up to 32 of them, in milliseconds.",
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
    /// The rate over the whole periods that end in the interval. `None` for a publisher that came during the interval.
    hz: Option<f64>,
    /// The times between its last messages. `None` for fewer than two messages.
    gap_ms: Option<Millis>,
}

impl Row {
    fn gap(&self, of: fn(&Millis) -> f64) -> String {
        number(self.gap_ms.as_ref().map(of), 3)
    }
}

impl columns::Row for Row {
    const COLUMNS: &'static [Column<Self>] = &[
        ("PUBLISHER", |it| it.node.clone()),
        ("HZ", |it| number(it.hz, 2)),
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
        let interval = look.now.since(look.before);
        look.of_interfaces(|entity, entry| {
            let before = look.before.interface(look.view.domain, entity);
            let rate = before.and_then(|before| hz(before, entry, interval));
            Self {
                node: look.view.name_of(entity.node).to_owned(),
                interface: entity.interface.0,
                messages: entry.messages,
                hz: rate.map(hundredths),
                gap_ms: entry.gaps().map(Millis::from),
            }
        })
    }
}

/// The rate of a publisher between its last message in an earlier sample and its last message in the sample that was
/// made `interval` later. Without an earlier message, the rate in the interval.
fn hz(before: &Entry, now: &Entry, interval: Duration) -> Option<f64> {
    let rate = now.rate_since(before, interval)?.messages_per_s;
    let periods = now.messages - before.messages;
    let time_s = now.last.since(before.last).as_secs_f64();
    let has_periods = periods > 0 && before.messages > 0 && time_s > 0.0;
    Some(if has_periods {
        periods as f64 / time_s
    } else {
        rate
    })
}

#[cfg(test)]
mod tests {
    use sm2_proto::Instant;

    use super::*;

    fn entry(messages: u64, last_ms: u64) -> Entry {
        Entry {
            messages,
            last: Instant(last_ms * 1_000_000),
            ..Entry::default()
        }
    }

    #[test]
    fn the_rate_is_that_of_whole_periods() {
        let of = |before, now| hz(&before, &now, Duration::from_secs(1));
        // 31 messages of 30 Hz in one second: as many as there are when both ends are near a message.
        let last_ms = 1_000 + 31 * 1_000 / 30;
        let rate = of(entry(10, 1_000), entry(41, last_ms)).unwrap();
        assert!((rate - 30.0).abs() < 0.03, "{rate}");
        // A period that is longer than the interval.
        assert_eq!(of(entry(10, 1_000), entry(11, 5_000)), Some(0.25));
        assert_eq!(of(entry(10, 1_000), entry(10, 1_000)), Some(0.0));
        // The first messages.
        assert_eq!(of(entry(0, 0), entry(3, 5_000)), Some(3.0));
        // Another publisher, or times that cannot be.
        assert_eq!(of(entry(10, 1_000), entry(2, 5_000)), None);
        assert_eq!(of(entry(10, 5_000), entry(12, 1_000)), Some(2.0));
    }
}
