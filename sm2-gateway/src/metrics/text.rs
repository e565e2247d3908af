//! The OpenMetrics text of a report.

use std::fmt;

use prometheus_client::{
    encoding::text::encode as encode_registry,
    metrics::{counter::Counter, family::Family, gauge::Gauge},
    registry::{Registry, Unit},
};

use crate::{Counts, Report};

type Labels = Vec<(&'static str, String)>;
type Counters = Family<Labels, Counter>;

/// A gauge of fractions. Its type names the atomic where `prometheus-client` keeps the bits.
#[expect(
    clippy::disallowed_types,
    reason = "a type parameter of prometheus-client, not memory shared with a process"
)]
type FractionGauge = Gauge<f64, std::sync::atomic::AtomicU64>;

/// The name of a count, its help, and its field.
type Count = (&'static str, &'static str, fn(&Counts) -> u64);

const COUNTS: [Count; 9] = [
    ("offered", "given to the scheduler", |it| it.offered),
    ("sent", "wholly handed to QUIC", |it| it.sent),
    (
        "superseded",
        "dropped by the scheduler for newer ones",
        |it| it.superseded,
    ),
    ("expired", "dropped by the scheduler as too old", |it| {
        it.expired
    }),
    ("withdrawn", "dropped because no longer wanted", |it| {
        it.withdrawn
    }),
    ("received", "received completely", |it| it.received),
    ("refused", "refused on arrival", |it| it.refused),
    (
        "lost",
        "dropped because a queue of this gateway was full",
        |it| it.lost,
    ),
    ("skipped", "missing between the origin and here", |it| {
        it.skipped
    }),
];

/// A metric of a program, without labels of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Value {
    /// Its name, without the prefix and without `_total`.
    pub name: &'static str,
    /// Its help.
    pub help: &'static str,
    /// Its kind.
    pub kind: ValueKind,
    /// The present value.
    pub value: u64,
}

/// The kind of a metric.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ValueKind {
    /// It only grows. The text appends `_total` to its name.
    Counter,
    /// It grows and shrinks.
    Gauge,
}

/// Encodes metrics in the OpenMetrics text format. All of them have the same prefix and the same labels.
///
/// # Errors
/// Never for values of this type; the encoder may refuse others.
pub fn encode(
    prefix: &str,
    labels: &[(&'static str, String)],
    values: &[Value],
) -> Result<String, fmt::Error> {
    let labels = labels.iter().cloned();
    let mut registry = Registry::with_labels(labels.map(|(key, value)| (key.into(), value.into())));
    let named = registry.sub_registry_with_prefix(prefix);
    for it in values {
        match it.kind {
            ValueKind::Counter => {
                let counter = Counter::<u64>::default();
                counter.inc_by(it.value);
                named.register(it.name, it.help, counter);
            }
            ValueKind::Gauge => {
                let gauge = Gauge::<i64>::default();
                gauge.set(i64::try_from(it.value).unwrap_or(i64::MAX));
                named.register(it.name, it.help, gauge);
            }
        }
    }
    let mut text = String::new();
    encode_registry(&mut text, &registry)?;
    Ok(text)
}

/// Encodes a report in the OpenMetrics text format.
pub(super) fn text(report: &Report) -> Result<String, fmt::Error> {
    let gateway = ("gateway".into(), report.name.clone().into());
    let mut registry = Registry::with_labels([gateway].into_iter());
    let registry_of_gateway = registry.sub_registry_with_prefix("sm2_gateway");
    peers(report, registry_of_gateway);
    counts(report, registry_of_gateway);
    let mut text = String::new();
    encode_registry(&mut text, &registry)?;
    Ok(text)
}

fn peers(report: &Report, registry: &mut Registry) {
    let connected = Family::<Labels, Gauge>::default();
    let denied = Family::<Labels, Gauge>::default();
    let rtt = Family::<Labels, FractionGauge>::default();
    for name in &report.absent {
        connected.get_or_create(&of(name)).set(0);
    }
    for peer in &report.peers {
        let labels = of(&peer.name);
        connected.get_or_create(&labels).set(1);
        let names = i64::try_from(peer.denied).unwrap_or(i64::MAX);
        denied.get_or_create(&labels).set(names);
        if let Some(ms) = peer.rtt_ms {
            rtt.get_or_create(&labels).set(ms / 1e3);
        }
    }
    let waiting = Gauge::<i64>::default();
    waiting.set(i64::try_from(report.waiting.len()).unwrap_or(i64::MAX));
    let help = "Topics and services that peers want and that the gateway has no descriptors for";
    registry.register("waiting_names", help, waiting);
    let help = "Whether there is a connection";
    registry.register("peer_connected", help, connected);
    let help = "Topics and services that the rules deny";
    registry.register("peer_denied", help, denied);
    let help = "Round-trip time";
    registry.register_with_unit("peer_rtt", help, Unit::Seconds, rtt);
}

fn counts(report: &Report, registry: &mut Registry) {
    for (word, help, count) in COUNTS {
        let (all, named) = (Counters::default(), Counters::default());
        for peer in &report.peers {
            let add = |family: &Counters, labels: &Labels, counts| {
                family.get_or_create(labels).inc_by(count(counts));
            };
            let mut labels = of(&peer.name);
            add(&all, &labels, &peer.messages);
            for it in &peer.subjects {
                if it.counts == Counts::default() {
                    continue;
                }
                labels.truncate(1);
                labels.push(("kind", it.kind.clone()));
                labels.push(("name", it.name.clone()));
                add(&named, &labels, &it.counts);
            }
        }
        let of_all = format!("Messages, requests and replies {help}");
        registry.register(format!("peer_{word}"), of_all, all);
        let of_one = format!("Messages, or requests and replies, of one name: {help}");
        registry.register(word, of_one, named);
    }
}

fn of(peer: &str) -> Labels {
    vec![("peer", peer.to_owned())]
}

#[cfg(test)]
mod tests {
    use crate::{
        peer::Limits,
        report::{PeerReport, SubjectReport},
    };

    use super::*;

    #[test]
    fn the_metrics_of_a_program_have_its_prefix_and_its_labels() {
        let value = |name, kind, value| Value {
            name,
            help: "Messages",
            kind,
            value,
        };
        let values = [
            value("sent", ValueKind::Counter, u64::MAX),
            value("waiting", ValueKind::Gauge, 7),
        ];
        let text = encode("robot", &[("name", "a\"b".to_owned())], &values).unwrap();
        let lines: Vec<_> = text.lines().filter(|it| !it.starts_with('#')).collect();
        assert_eq!(
            lines,
            [
                "robot_sent_total{name=\"a\\\"b\"} 18446744073709551615",
                "robot_waiting{name=\"a\\\"b\"} 7"
            ],
            "{text}"
        );
    }

    #[test]
    fn each_count_of_a_peer_and_of_a_name_is_there_once() {
        let counts = Counts {
            skipped: u64::MAX,
            ..Counts::ALL_DIFFERENT
        };
        let subject = |name: &str, counts| SubjectReport {
            kind: "topic".to_owned(),
            name: name.to_owned(),
            counts,
        };
        let peer = PeerReport {
            name: "far".to_owned(),
            id: "ab".to_owned(),
            address: None,
            connected_s: None,
            rtt_ms: Some(1.5),
            offers: Vec::new(),
            offered: Vec::new(),
            messages: counts,
            subjects: vec![subject("a", counts), subject("quiet", Counts::default())],
            denied: 9,
            denials: Vec::new(),
        };
        let report = Report {
            name: "near".to_owned(),
            id: "cd".to_owned(),
            peers: vec![peer],
            absent: vec!["away".to_owned()],
            waiting: vec!["topic flood".to_owned(); 3],
            limits: Limits::default(),
            shadow: None,
        };
        let text = text(&report).unwrap();
        for (number, (word, _, count)) in (1..).zip(COUNTS) {
            let value = if number == 9 { u64::MAX } else { number };
            assert_eq!(count(&counts), value);
            for line in [
                format!("sm2_gateway_peer_{word}_total{{gateway=\"near\",peer=\"far\"}} {value}"),
                format!(
                    "sm2_gateway_{word}_total{{gateway=\"near\",peer=\"far\",kind=\"topic\",name=\"a\"}} {value}"
                ),
            ] {
                assert_eq!(
                    text.lines().filter(|it| *it == line).count(),
                    1,
                    "{line}\n{text}"
                );
            }
        }
        for line in [
            "sm2_gateway_peer_connected{gateway=\"near\",peer=\"far\"} 1",
            "sm2_gateway_peer_connected{gateway=\"near\",peer=\"away\"} 0",
            "sm2_gateway_peer_denied{gateway=\"near\",peer=\"far\"} 9",
            "sm2_gateway_peer_rtt_seconds{gateway=\"near\",peer=\"far\"} 0.0015",
            "sm2_gateway_waiting_names{gateway=\"near\"} 3",
            "# EOF",
        ] {
            assert!(text.lines().any(|it| it == line), "{line}\n{text}");
        }
        assert!(!text.contains("quiet"), "{text}");
    }
}
