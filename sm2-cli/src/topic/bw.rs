//! `sm2 topic bw`: the bandwidth of published messages.

use clap::Args;
use serde::Serialize;
use sm2_proto::Kind;

use super::measure::{self, Look, Measure, cell};
use crate::{ended::Ended, error::CliError, sampling::hundredths};

/// `sm2 topic bw`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    #[command(flatten)]
    common: measure::Common,
}

const HELP: &str = "\
A message counts once, whatever the number of its subscribers. MEAN SIZE is the mean size of the
messages in the interval.

The command reads counters that every node keeps: it does not subscribe, and publishers do not notice
it. It waits for a topic that does not exist yet; with --count, for 10 s (see --timeout).

Exit status: 0 ended by Ctrl-C or after --count reports, 1 failed, 2 wrong usage, 130 Ctrl-C before
--count reports were made.

Examples:
  sm2 topic bw camera
  sm2 topic bw camera --interval 5s --count 1 --json";

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

struct Bw;

impl Measure<5> for Bw {
    const ROLE: &str = "bw";
    const OF: Kind = Kind::Publisher;
    const ROWS: &str = "publishers";
    const HEADINGS: [&str; 5] = ["PUBLISHER", "MB/s", "MEAN SIZE", "MESSAGES", "BYTES"];
    const TEXTS: usize = 1;
    type Row = Row;

    fn rows(look: &Look<'_>) -> Vec<Row> {
        let domain = look.view.domain;
        let row = |entity| {
            let entry = look.now.interface(domain, entity)?;
            let rate = look.now.rate(look.before, domain, entity);
            let moving = rate.filter(|rate| rate.messages_per_s > 0.0);
            Some(Row {
                node: look.view.name_of(entity.node).to_owned(),
                interface: entity.interface.0,
                messages: entry.messages,
                bytes: entry.bytes,
                bytes_per_s: rate.map(|rate| hundredths(rate.bytes_per_s)),
                mean_size_bytes: moving.map(|it| hundredths(it.bytes_per_s / it.messages_per_s)),
            })
        };
        let publishers = look.counted(Kind::Publisher);
        publishers.filter_map(|it| row(it.entity)).collect()
    }

    fn cells(row: &Row) -> [String; 5] {
        [
            row.node.clone(),
            cell(row.bytes_per_s.map(|bytes| bytes / 1e6), 6),
            cell(row.mean_size_bytes, 0),
            row.messages.to_string(),
            row.bytes.to_string(),
        ]
    }
}

/// Runs the command.
pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    measure::run::<5, Bw>(&arguments.common)
}
