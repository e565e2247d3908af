//! `sm2 topic loss`: the fates of messages.

use clap::Args;
use serde::Serialize;
use sm2_proto::{Kind, link::Counters};

use super::measure::{self, Look, Measure, cell};
use crate::{ended::Ended, error::CliError};

/// `sm2 topic loss`.
#[derive(Args, Debug)]
#[command(after_help = HELP)]
pub(crate) struct Arguments {
    #[command(flatten)]
    common: measure::Common,
}

const HELP: &str = "\
For each link since it was made: messages OFFERED to it, DELIVERED (released by the subscriber's
program), OVERWRITTEN (by newer ones before they were sent), DISCARDED (replaced by newer ones before
they were received), dropped at a DEADLINE, CLOSED (lost with the link), and IN FLIGHT. POOL LIMIT is
the number of messages that were not sent because the subscriber held too much of the publisher's
memory. TOO LONG counts those that are longer than the subscriber accepts, and EXPIRED those that were
older than their lifespan. OFFERED is the sum of all these. LOST is the number of messages that the
subscriber has counted as lost on the link. AWAY is the number of those that were published before the
link was made, after an earlier link of the same pair had ended.

The command reads counters that every node keeps: it does not subscribe, and publishers do not notice
it. It waits for a topic that does not exist yet; with --count, for 10 s (see --timeout).

Exit status: 0 ended by Ctrl-C or after --count reports, 1 failed, 2 wrong usage, 130 Ctrl-C before
--count reports were made.

Examples:
  sm2 topic loss camera
  sm2 topic loss camera --count 1 --json | jq '.links[] | select(.lost > 0)'";

/// A link.
#[derive(Serialize)]
pub(super) struct Row {
    publisher: String,
    subscriber: String,
    #[serde(flatten)]
    fates: Fates,
    /// `None` if the subscriber keeps no counters.
    lost: Option<u64>,
    /// Likewise.
    away: Option<u64>,
}

/// The fates of the messages of a link. Field names are part of the command's interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Fates {
    pub(crate) offered: u64,
    pub(crate) delivered: u64,
    overwritten: u64,
    discarded: u64,
    deadline: u64,
    closed: u64,
    pool_limit: u64,
    too_long: u64,
    expired: u64,
    pub(crate) in_flight: u64,
}

impl Fates {
    /// The number of messages that did not arrive, for any reason.
    pub(crate) const fn dropped(&self) -> u64 {
        self.overwritten
            .saturating_add(self.discarded)
            .saturating_add(self.deadline)
            .saturating_add(self.closed)
            .saturating_add(self.pool_limit)
            .saturating_add(self.too_long)
            .saturating_add(self.expired)
    }
}

impl From<&Counters> for Fates {
    fn from(of: &Counters) -> Self {
        Self {
            offered: of.offered,
            delivered: of.delivered,
            overwritten: of.overwritten,
            discarded: of.discarded,
            deadline: of.deadline,
            closed: of.closed,
            pool_limit: of.pool_limit,
            too_long: of.too_long,
            expired: of.expired,
            in_flight: of.in_flight,
        }
    }
}

struct Loss;

impl Measure<14> for Loss {
    const ROLE: &str = "loss";
    const OF: Kind = Kind::Publisher;
    const ROWS: &str = "links";
    const HEADINGS: [&str; 14] = [
        "PUBLISHER",
        "SUBSCRIBER",
        "OFFERED",
        "DELIVERED",
        "OVERWRITTEN",
        "DISCARDED",
        "DEADLINE",
        "CLOSED",
        "POOL LIMIT",
        "TOO LONG",
        "EXPIRED",
        "IN FLIGHT",
        "LOST",
        "AWAY",
    ];
    const TEXTS: usize = 2;
    type Row = Row;

    fn rows(look: &Look<'_>) -> Vec<Row> {
        let publishers = look.counted(Kind::Publisher);
        let links = publishers.flat_map(|it| look.view.links_of(it.entity));
        links
            .filter_map(|link| {
                let entry = look.now.offering(look.view.domain, link)?;
                let taken = look.now.demanding(look.view.domain, link);
                Some(Row {
                    publisher: look.view.name_of(link.offering.node).to_owned(),
                    subscriber: look.view.name_of(link.demanding.node).to_owned(),
                    fates: Fates::from(&entry.fates),
                    lost: taken.map(|entry| entry.lost),
                    away: taken.map(|entry| entry.away),
                })
            })
            .collect()
    }

    fn cells(row: &Row) -> [String; 14] {
        let fates = &row.fates;
        [
            row.publisher.clone(),
            row.subscriber.clone(),
            fates.offered.to_string(),
            fates.delivered.to_string(),
            fates.overwritten.to_string(),
            fates.discarded.to_string(),
            fates.deadline.to_string(),
            fates.closed.to_string(),
            fates.pool_limit.to_string(),
            fates.too_long.to_string(),
            fates.expired.to_string(),
            fates.in_flight.to_string(),
            cell(row.lost.map(|lost| lost as f64), 0),
            cell(row.away.map(|away| away as f64), 0),
        ]
    }
}

/// Runs the command.
pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    measure::run::<14, Loss>(&arguments.common)
}
