//! The messages of a bridge, counted: for people, and for Prometheus.
//!
//! | metric | |
//! | --- | --- |
//! | `sm2_bridge_COUNT_total` | each field of [`Counts`] |
//! | `sm2_bridge_spool_COUNT_total` | messages of durable topics: `offered`, `handed_over`, `expired`, `refused` |
//! | `sm2_bridge_spool_spooled`, `sm2_bridge_spool_in_flight` | those that have no fate yet |
//!
//! Each metric has the labels `bridge`, the name of the bridge, and `network`, such as `zenoh`.

use std::fmt;
use std::sync::Arc;

use sm2_gateway::metrics::{Value, ValueKind, encode};
use sm2_proto::Name;

use crate::inbound::Verdict;
use crate::spool::SpoolCounts;

/// Messages since the start: those of topics, requests and replies.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// From the domain to the network; messages of durable topics each time that they are sent.
    pub sent: u64,
    /// From the network to the domain.
    pub received: u64,
    /// Newer messages displaced them before the bridge took them from the domain.
    pub lost: u64,
    /// Newer messages displaced them while they waited for the network.
    pub superseded: u64,
    /// They waited for the network for longer than `max_age_ms` of their rule.
    pub expired: u64,
    /// They waited for the network when the bridge ended.
    pub withdrawn: u64,
    /// The network or the domain refuses them, or they are damaged.
    pub refused: u64,
    /// The rules do not let them in.
    pub denied: u64,
    /// They come from a bridge of the same domain.
    pub returned: u64,
    /// They came again, and were not published again.
    pub duplicates: u64,
    /// A gateway brings them to the domain.
    pub left_to_gateway: u64,
    /// They came from the network while too many others waited.
    pub dropped: u64,
}

/// The name of a count, its help, and its field.
type Count = (&'static str, &'static str, fn(&Counts) -> u64);

const COUNTS: [Count; 12] = [
    ("sent", "Messages given to the network", |it| it.sent),
    ("received", "Messages published in the domain", |it| {
        it.received
    }),
    ("lost", "Messages displaced in the domain", |it| it.lost),
    (
        "superseded",
        "Messages displaced while they waited for the network",
        |it| it.superseded,
    ),
    (
        "expired",
        "Messages too old when the network could take them",
        |it| it.expired,
    ),
    (
        "withdrawn",
        "Messages that waited for the network at the end",
        |it| it.withdrawn,
    ),
    (
        "refused",
        "Messages that are damaged, or that a side refuses",
        |it| it.refused,
    ),
    (
        "denied",
        "Messages of the network that the rules deny",
        |it| it.denied,
    ),
    (
        "returned",
        "Messages from a bridge of the same domain",
        |it| it.returned,
    ),
    ("duplicates", "Messages that came again", |it| it.duplicates),
    (
        "left_to_gateway",
        "Messages that a gateway brings to the domain",
        |it| it.left_to_gateway,
    ),
    (
        "dropped",
        "Messages of the network that found no room",
        |it| it.dropped,
    ),
];

impl Counts {
    /// Counts the end of a message of the network.
    pub const fn note(&mut self, verdict: Verdict) {
        let count = match verdict {
            Verdict::Denied => &mut self.denied,
            Verdict::Returned => &mut self.returned,
            Verdict::LeftToGateway => &mut self.left_to_gateway,
            Verdict::Duplicate => &mut self.duplicates,
            Verdict::Refused => &mut self.refused,
            Verdict::Dropped => &mut self.dropped,
            Verdict::Published => &mut self.received,
        };
        *count += 1;
    }
}

impl fmt::Display for Counts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (index, (name, _, count)) in COUNTS.iter().enumerate() {
            let comma = if index == 0 { "" } else { ", " };
            write!(f, "{comma}{} {}", count(self), name.replace('_', " "))?;
        }
        Ok(())
    }
}

/// All counts of a bridge at one time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Account {
    /// The name of the bridge.
    pub bridge: Name,
    /// The kind of its network, such as `zenoh`.
    pub network: &'static str,
    /// The messages.
    pub counts: Counts,
    /// The messages of durable topics. `None` without a spool.
    pub spool: Option<SpoolCounts>,
}

/// The account of a running bridge, for other threads.
pub type ReadAccount = Arc<dyn Fn() -> Account + Send + Sync>;

impl Account {
    /// The metrics in the OpenMetrics text format. `None` never happens with names that are legal.
    #[must_use]
    pub fn metrics(&self) -> Option<String> {
        let value = |kind| {
            move |name, help, value| Value {
                name,
                help,
                kind,
                value,
            }
        };
        let (counter, gauge) = (value(ValueKind::Counter), value(ValueKind::Gauge));
        let counts = COUNTS.iter();
        let mut values: Vec<_> = counts
            .map(|(name, help, count)| counter(name, help, count(&self.counts)))
            .collect();
        if let Some(spool) = &self.spool {
            values.extend([
                counter("spool_offered", "Messages of durable topics", spool.offered),
                counter(
                    "spool_handed_over",
                    "Messages of durable topics that are acknowledged",
                    spool.handed_over,
                ),
                counter(
                    "spool_expired",
                    "Messages of durable topics that became too old, or found no room",
                    spool.expired,
                ),
                counter(
                    "spool_refused",
                    "Messages of durable topics that are too long, or cannot be stored",
                    spool.refused,
                ),
                gauge(
                    "spool_spooled",
                    "Messages of durable topics that wait",
                    spool.spooled,
                ),
                gauge(
                    "spool_in_flight",
                    "Messages of durable topics that wait for an acknowledgement",
                    spool.in_flight,
                ),
            ]);
        }
        let labels = [
            ("bridge", self.bridge.to_string()),
            ("network", self.network.to_owned()),
        ];
        encode("sm2_bridge", &labels, &values).ok()
    }
}

impl fmt::Display for Account {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.spool {
            Some(spool) => write!(f, "{}\ndurable topics: {spool}", self.counts),
            None => write!(f, "{}", self.counts),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_count_is_in_the_summary_and_in_the_metrics_once() {
        let mut account = Account {
            bridge: Name::new("seven").unwrap(),
            network: "zenoh",
            counts: Counts {
                sent: 1,
                received: 2,
                lost: 3,
                superseded: 4,
                expired: 5,
                withdrawn: 6,
                refused: 7,
                denied: 8,
                returned: 9,
                duplicates: 10,
                left_to_gateway: 11,
                dropped: 12,
            },
            spool: None,
        };
        let summary = account.to_string();
        let text = account.metrics().unwrap();
        for (number, (name, _, _)) in (1..).zip(COUNTS) {
            let words = format!("{number} {}", name.replace('_', " "));
            assert_eq!(summary.split(", ").filter(|it| *it == words).count(), 1);
            let line =
                format!("sm2_bridge_{name}_total{{bridge=\"seven\",network=\"zenoh\"}} {number}");
            assert_eq!(
                text.lines().filter(|it| *it == line).count(),
                1,
                "{line}\n{text}"
            );
        }
        assert!(!text.contains("spool"), "{text}");
        account.spool = Some(SpoolCounts {
            offered: 21,
            handed_over: 22,
            expired: 23,
            refused: 24,
            spooled: 25,
            in_flight: 26,
        });
        let text = account.metrics().unwrap();
        let labels = "{bridge=\"seven\",network=\"zenoh\"}";
        for line in [
            format!("sm2_bridge_spool_offered_total{labels} 21"),
            format!("sm2_bridge_spool_handed_over_total{labels} 22"),
            format!("sm2_bridge_spool_expired_total{labels} 23"),
            format!("sm2_bridge_spool_refused_total{labels} 24"),
            format!("sm2_bridge_spool_spooled{labels} 25"),
            format!("sm2_bridge_spool_in_flight{labels} 26"),
        ] {
            assert!(text.lines().any(|it| it == line), "{line}\n{text}");
        }
    }
}
