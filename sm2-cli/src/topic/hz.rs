//! `sm2 topic hz`: the rate at which messages are published.

use clap::Args;
use serde::Serialize;
use sm2_proto::{Kind, counters::Entry};

use super::measure::{self, Look, Measure, cell};
use crate::{
    ended::Ended,
    error::CliError,
    sampling::{Millis, hundredths},
};

/// `sm2 topic hz`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    #[command(flatten)]
    common: measure::Common,
}

const HELP: &str = "\
HZ is the number of messages that each publisher published per second of the interval. The other
columns are the times between its last messages, up to 32 of them, in milliseconds.

The command reads counters that every node keeps: it does not subscribe, and publishers do not notice
it. It waits for a topic that does not exist yet; with --count, for 10 s (see --timeout).

Exit status: 0 ended by Ctrl-C or after --count reports, 1 failed, 2 wrong usage, 130 Ctrl-C before
--count reports were made.

Examples:
  sm2 topic hz scan
  sm2 topic hz scan --interval 200ms --count 5
  sm2 topic hz scan --json | jq '.publishers[].hz'";

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

struct Hz;

impl Measure<7> for Hz {
    const ROLE: &str = "hz";
    const OF: Kind = Kind::Publisher;
    const ROWS: &str = "publishers";
    const HEADINGS: [&str; 7] = [
        "PUBLISHER",
        "HZ",
        "MEAN ms",
        "MIN ms",
        "MAX ms",
        "STD DEV ms",
        "MESSAGES",
    ];
    const TEXTS: usize = 1;
    type Row = Row;

    fn rows(look: &Look<'_>) -> Vec<Row> {
        let domain = look.view.domain;
        let row = |entity| {
            let entry: &Entry = look.now.interface(domain, entity)?;
            let rate = look.now.rate(look.before, domain, entity);
            Some(Row {
                node: look.view.name_of(entity.node).to_owned(),
                interface: entity.interface.0,
                messages: entry.messages,
                hz: rate.map(|rate| hundredths(rate.messages_per_s)),
                gap_ms: entry.gaps().map(Millis::from),
            })
        };
        let publishers = look.counted(Kind::Publisher);
        publishers.filter_map(|it| row(it.entity)).collect()
    }

    fn cells(row: &Row) -> [String; 7] {
        let gap = |of: fn(&Millis) -> f64| cell(row.gap_ms.as_ref().map(of), 3);
        [
            row.node.clone(),
            cell(row.hz, 2),
            gap(|it| it.mean),
            gap(|it| it.min),
            gap(|it| it.max),
            gap(|it| it.std_dev),
            row.messages.to_string(),
        ]
    }
}

/// Runs the command.
pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    measure::run::<7, Hz>(&arguments.common)
}
