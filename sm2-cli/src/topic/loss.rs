//! `sm2 topic loss`: the fates of messages.

use clap::Args;
use serde::{Serialize, Serializer};
use sm2_proto::{
    Kind,
    link::{Counters, Fate},
};

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
Each number counts the messages of a link since it was made:
  OFFERED      the sum of the next nine
  DELIVERED    released by the subscriber's program
  OVERWRITTEN  replaced by newer ones before they were sent
  DISCARDED    replaced by newer ones before they were received
  NO ROOM      dropped because there was no room before their deadline
  CLOSED       lost with the link
  POOL LIMIT   not sent because the subscriber held too much of the publisher's memory
  TOO LONG     longer than the subscriber accepts
  EXPIRED      older than their lifespan
  IN FLIGHT    sent, and not settled yet
  LOST         counted as lost by the subscriber
  AWAY         published before the link was made, after an earlier link of the same pair had ended

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

/// The fates of the messages of a link, as a map of their names. They are part of the command's interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Fates(pub(crate) Counters);

impl Fates {
    /// The names and numbers in the order in which they are shown. The first number is the sum of the others.
    fn all(self) -> impl Iterator<Item = (&'static str, u64)> {
        let fates = Fate::ALL.map(|fate| (fate.as_str(), self.0.of(fate)));
        let offered = [("offered", self.0.offered)].into_iter();
        offered
            .chain(fates)
            .chain([("in_flight", self.0.in_flight)])
    }
}

impl Serialize for Fates {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self.all())
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
        "NO ROOM",
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
                    fates: Fates(entry.fates),
                    lost: taken.map(|entry| entry.lost),
                    away: taken.map(|entry| entry.away),
                })
            })
            .collect()
    }

    fn cells(row: &Row) -> [String; 14] {
        let ends = [row.publisher.clone(), row.subscriber.clone()].into_iter();
        let fates = row.fates.all().map(|(_, messages)| messages.to_string());
        let losses = [row.lost, row.away].map(|it| cell(it.map(|messages| messages as f64), 0));
        let mut cells = ends.chain(fates).chain(losses);
        std::array::from_fn(|_| cells.next().unwrap_or_default())
    }
}

/// Runs the command.
pub(super) fn run(arguments: &Arguments) -> Result<Ended, CliError> {
    measure::run::<14, Loss>(&arguments.common)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_number_has_the_heading_of_its_name() {
        let names = Fates(Counters::default()).all();
        let names: Vec<_> = names
            .map(|(name, _)| name.to_uppercase().replace('_', " "))
            .collect();
        assert_eq!(names, <Loss as Measure<14>>::HEADINGS[2..12]);
    }
}
