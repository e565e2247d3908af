//! `sm2 topic loss`: the fates of messages.

use serde::{Serialize, Serializer};
use sm2_proto::{
    Kind,
    link::{Counters, Fate},
};

use super::measure::{Look, Measure, help};
use crate::columns::{self, Column, cell};

pub(super) const HELP: &str = help!(
    "\
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
  IN FLIGHT    sent, and neither delivered nor dropped yet
  LOST         counted as lost by the subscriber
  AWAY         published before the link was made, after an earlier link of the same pair had ended",
    "  sm2 topic loss camera
  sm2 topic loss camera --count 1 --json | jq '.links[] | select(.lost > 0)'"
);

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

impl Serialize for Fates {
    /// The first number is the sum of the others.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let fates = Fate::ALL.map(|fate| (fate.as_str(), self.0.of(fate)));
        let offered = [("offered", self.0.offered)].into_iter();
        let in_flight = [("in_flight", self.0.in_flight)];
        serializer.collect_map(offered.chain(fates).chain(in_flight))
    }
}

impl Row {
    fn of(&self, fate: Fate) -> String {
        self.fates.0.of(fate).to_string()
    }
}

impl columns::Row for Row {
    const COLUMNS: &'static [Column<Self>] = &[
        ("PUBLISHER", |it| it.publisher.clone()),
        ("SUBSCRIBER", |it| it.subscriber.clone()),
        ("OFFERED", |it| it.fates.0.offered.to_string()),
        ("DELIVERED", |it| it.of(Fate::Delivered)),
        ("OVERWRITTEN", |it| it.of(Fate::Overwritten)),
        ("DISCARDED", |it| it.of(Fate::Discarded)),
        ("NO ROOM", |it| it.of(Fate::NoRoom)),
        ("CLOSED", |it| it.of(Fate::Closed)),
        ("POOL LIMIT", |it| it.of(Fate::PoolLimit)),
        ("TOO LONG", |it| it.of(Fate::TooLong)),
        ("EXPIRED", |it| it.of(Fate::Expired)),
        ("IN FLIGHT", |it| it.fates.0.in_flight.to_string()),
        ("LOST", |it| cell(it.lost)),
        ("AWAY", |it| cell(it.away)),
    ];
}

impl Measure for Row {
    const ROLE: &str = "loss";
    const OF: Kind = Kind::Publisher;
    const ROWS: &str = "links";
    const TEXTS: usize = 2;

    fn rows(look: &Look<'_>) -> Vec<Self> {
        look.of_links(|link| {
            let entry = look.now.offering(look.view.domain, link)?;
            let taken = look.now.demanding(look.view.domain, link);
            Some(Self {
                publisher: look.view.name_of(link.offering.node).to_owned(),
                subscriber: look.view.name_of(link.demanding.node).to_owned(),
                fates: Fates(entry.fates),
                lost: taken.map(|entry| entry.lost),
                away: taken.map(|entry| entry.away),
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_fate_has_a_column_of_its_name() {
        let headings = <Row as columns::Row>::COLUMNS
            .iter()
            .map(|(heading, _)| *heading);
        let headings: Vec<_> = headings.skip(3).take(Fate::ALL.len()).collect();
        let names = Fate::ALL.map(|it| it.as_str().to_uppercase().replace('_', " "));
        assert_eq!(names, *headings);
    }
}
