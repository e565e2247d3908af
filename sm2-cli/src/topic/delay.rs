//! `sm2 topic delay`: the delays of messages from publishing to receiving.

use clap::Args;
use serde::Serialize;
use sm2_proto::{Kind, counters::Entry};

use super::measure::{self, Look, Measure, cell};
use crate::{
    ended::Ended,
    error::CliError,
    sampling::{median_ns, millis},
};

/// `sm2 topic delay`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    #[command(flatten)]
    common: measure::Common,
}

const HELP: &str = "\
The delay of a message is the time from publishing until the subscriber's program receives it, in
milliseconds. The figures cover up to 32 last messages of each link; WORST is the longest delay since
the link was made. A program that is slow to receive its messages has long delays.

The command reads counters that every node keeps: it does not subscribe, and publishers do not notice
it. It waits for a topic that does not exist yet; with --count, for 10 s (see --timeout).

Exit status: 0 ended by Ctrl-C or after --count reports, 1 failed, 2 wrong usage, 130 Ctrl-C before
--count reports were made.

Examples:
  sm2 topic delay scan
  sm2 topic delay scan --json | jq '.links[].p50_ms'";

/// The delays of one link.
#[derive(Serialize)]
pub(super) struct Row {
    publisher: String,
    subscriber: String,
    /// The number of messages that were received since the link was made.
    messages: u64,
    /// The number of messages that the next three figures cover.
    recent: u32,
    mean_ms: Option<f64>,
    p50_ms: Option<f64>,
    max_ms: Option<f64>,
    /// The longest delay since the link was made.
    worst_ms: f64,
}

struct Delay;

impl Measure<7> for Delay {
    const ROLE: &str = "delay";
    const OF: Kind = Kind::Subscriber;
    const ROWS: &str = "links";
    const HEADINGS: [&str; 7] = [
        "SUBSCRIBER",
        "PUBLISHER",
        "MEAN ms",
        "P50 ms",
        "MAX ms",
        "WORST ms",
        "MESSAGES",
    ];
    const TEXTS: usize = 2;
    type Row = Row;

    fn rows(look: &Look<'_>) -> Vec<Row> {
        let row = |publisher, subscriber, entry: &Entry| {
            let recent = entry.recent_delays();
            Row {
                publisher: look.view.name_of(publisher).to_owned(),
                subscriber: look.view.name_of(subscriber).to_owned(),
                messages: entry.messages,
                recent: recent.map_or(0, |it| it.count),
                mean_ms: recent.map(|it| millis(it.mean_ns)),
                p50_ms: median_ns(entry).map(millis),
                max_ms: recent.map(|it| millis(it.max_ns)),
                worst_ms: millis(entry.delay_max_ns),
            }
        };
        let subscribers = look.counted(Kind::Subscriber);
        let links = subscribers.flat_map(|it| look.view.links_of(it.entity));
        links
            .filter_map(|link| {
                let entry = look.now.demanding(look.view.domain, link)?;
                Some(row(link.offering.node, link.demanding.node, entry))
            })
            .collect()
    }

    fn cells(row: &Row) -> [String; 7] {
        [
            row.subscriber.clone(),
            row.publisher.clone(),
            cell(row.mean_ms, 3),
            cell(row.p50_ms, 3),
            cell(row.max_ms, 3),
            cell(Some(row.worst_ms), 3),
            row.messages.to_string(),
        ]
    }
}

/// Runs the command.
pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    measure::run::<7, Delay>(&arguments.common)
}
