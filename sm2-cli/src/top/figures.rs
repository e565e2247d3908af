//! The tables of `sm2 top`: the figures of topics and nodes in the last interval.

use std::collections::BTreeMap;

use serde::Serialize;
use serde_json::Value;
use sm2_proto::{
    Contract, Kind, Name, NodeId,
    domain::{InterfaceView, LinkView},
};

use super::table::{Cell, Column, NAME, Table, column, loss, plus, rate};
use crate::{
    interfaces::Type,
    observation::Readings,
    process::ProcessorUse,
    sampling::{median_ns, millis},
    troubles::untaken,
    view::View,
};

/// All figures of one interval.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Figures {
    pub(super) topics: Table,
    pub(super) nodes: Table,
}

/// The table that is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Tab {
    #[default]
    Topics,
    Nodes,
}

const MISSED: &str = "missed_deadlines_per_s";
const STALLED: &str = "stalled_s";

const TOPICS: &[Column] = &[
    column("TOPIC", "name", 0, NAME),
    column("TYPE", "type", 0, 0),
    column("PUBS", "publishers", 0, 2),
    column("SUBS", "subscribers", 0, 3),
    column("LINKS", "links", 0, 1),
    rate("HZ", "hz", 12),
    column("MB/s", "mb_per_s", 3, 8),
    column("P50 ms", "delay_p50_ms", 3, 7).that_ages(),
    loss("DROPPED", "dropped", 0, 5),
    loss("LOST", "lost", 0, 9),
    loss("LOSS/s", "lost_per_s", 1, 10),
    loss("MISS/s", MISSED, 1, 6).shown_with(MISSED),
    column("HELD", "held", 0, 4).shown_with(STALLED),
    loss("STALL s", STALLED, 1, 11).shown_with(STALLED),
];

const NODES: &[Column] = &[
    column("NODE", "name", 0, NAME),
    column("PID", "pid", 0, 2),
    column("CPU %", "cpu_percent", 1, 9),
    column("IFACES", "interfaces", 0, 0),
    column("LINKS", "links", 0, 1),
    rate("OUT/s", "out_per_s", 13),
    column("OUT MB/s", "out_mb_per_s", 3, 6),
    rate("IN/s", "in_per_s", 11),
    column("IN MB/s", "in_mb_per_s", 3, 5),
    loss("DROPPED", "dropped", 0, 4),
    loss("LOST", "lost", 0, 8),
    loss("LOSS/s", "lost_per_s", 1, 10),
    loss("MISS/s", MISSED, 1, 7).shown_with(MISSED),
    column("HELD", "held", 0, 3).shown_with(STALLED),
    loss("STALL s", STALLED, 1, 12).shown_with(STALLED),
];

/// The sums for a topic or a node. A figure that no node counts is `None`.
#[derive(Clone, Copy, Debug, Default, Serialize)]
struct Sums {
    interfaces: u32,
    publishers: u32,
    subscribers: u32,
    links: usize,
    out_per_s: Option<f64>,
    out_bytes_per_s: Option<f64>,
    in_per_s: Option<f64>,
    in_bytes_per_s: Option<f64>,
    dropped: Option<f64>,
    lost: Option<f64>,
    /// The messages of each second that were dropped on links to the subscribers and servers.
    lost_per_s: Option<f64>,
    missed_deadlines_per_s: Option<f64>,
    /// The samples that the subscribers hold.
    held: Option<f64>,
    /// The longest time that a subscriber or server has taken nothing while messages waited.
    stalled_s: Option<f64>,
    /// The largest median delay of all links.
    delay_ns: Option<u64>,
    /// Whether a message was taken in the interval, so that the delay is not an old one.
    delay_is_new: bool,
}

impl Figures {
    /// The figures of the time between two samples, without the node `itself`.
    pub(super) fn new(
        view: &View<'_>,
        readings: Readings<'_>,
        processors: &ProcessorUse,
        itself: &Name,
    ) -> Self {
        let mut topics: BTreeMap<&Name, Sums> = BTreeMap::new();
        let mut nodes: BTreeMap<NodeId, Sums> = BTreeMap::new();
        for it in view.granted() {
            let sums = sums(view, readings, it);
            if matches!(it.contract.kind(), Kind::Publisher | Kind::Subscriber) {
                topics.entry(it.contract.name()).or_default().add(&sums);
            }
            nodes.entry(it.entity.node).or_default().add(&sums);
        }
        let topics = topics
            .into_iter()
            .map(|(name, sums)| sums.topic(name.as_str(), view.topic_type(name).map(Type::from)));
        let others = view.domain.nodes().filter(|node| node.name != itself);
        let nodes = others.map(|node| {
            let sums = nodes.get(&node.node).copied().unwrap_or_default();
            sums.node(node.name.as_str(), node.pid, processors.percent(node.pid))
        });
        Self {
            topics: Table {
                columns: TOPICS,
                rows: topics.collect(),
            },
            nodes: Table {
                columns: NODES,
                rows: nodes.collect(),
            },
        }
    }

    pub(super) fn table(&self, tab: Tab) -> &Table {
        match tab {
            Tab::Topics => &self.topics,
            Tab::Nodes => &self.nodes,
        }
    }

    /// Both tables as one JSON object.
    pub(super) fn json(&self) -> Value {
        serde_json::json!({ "topics": self.topics.json(), "nodes": self.nodes.json() })
    }
}

/// The figures of one interface. Field names are part of the page of `sm2 view`.
#[derive(Debug, Serialize)]
pub(crate) struct InterfaceFigures {
    node_id: u64,
    interface: u64,
    #[serde(flatten)]
    sums: Sums,
}

impl InterfaceFigures {
    /// The figures of the time between two samples.
    pub(crate) fn new(view: &View<'_>, readings: Readings<'_>, it: InterfaceView<'_>) -> Self {
        Self {
            node_id: it.entity.node.0,
            interface: it.entity.interface.0,
            sums: sums(view, readings, it),
        }
    }
}

/// The figures of one interface.
fn sums(view: &View<'_>, readings: Readings<'_>, it: InterfaceView<'_>) -> Sums {
    let (domain, now) = (view.domain, readings.now);
    let links = view.links_of(it.entity);
    let rate = (readings.before).and_then(|before| now.rate(before, domain, it.entity));
    let mut sums = Sums {
        interfaces: 1,
        links: links.len(),
        ..Sums::default()
    };
    if matches!(
        it.contract,
        Contract::Publisher { .. } | Contract::Client { .. }
    ) {
        sums.out_per_s = rate.map(|rate| rate.messages_per_s);
        sums.out_bytes_per_s = rate.map(|rate| rate.bytes_per_s);
    } else {
        sums.in_per_s = rate.map(|rate| rate.messages_per_s);
        sums.in_bytes_per_s = rate.map(|rate| rate.bytes_per_s);
        sums.lost = now
            .interface(domain, it.entity)
            .map(|entry| entry.lost as f64);
    }
    let missed = readings.growth(
        |sample| sample.interface(domain, it.entity),
        |it| it.missed_deadlines,
    );
    sums.missed_deadlines_per_s = readings.per_s(missed);
    match it.contract.kind() {
        Kind::Publisher => {
            sums.publishers = 1;
            for link in links {
                let fates = now.offering(domain, link).map(|entry| entry.fates);
                let dropped = fates.map(|it| it.dropped() as f64);
                sums.dropped = plus(sums.dropped, dropped);
            }
        }
        Kind::Subscriber => {
            sums.subscribers = 1;
            let ends = links.iter().filter_map(|link| now.demanding(domain, link));
            sums.delay_ns = ends.clone().filter_map(median_ns).max();
            sums.delay_is_new = rate.is_none_or(|rate| rate.messages_per_s > 0.0);
            let held = ends.map(|end| end.held as f64);
            sums.held = held.fold(None, |sum, held| plus(sum, Some(held)));
            sums.receive(view, readings, links);
        }
        Kind::Server => sums.receive(view, readings, links),
        Kind::Client => {}
    }
    sums
}

impl Sums {
    /// Adds what the links to a subscriber or server lose, and how long it has taken nothing.
    fn receive(&mut self, view: &View<'_>, readings: Readings<'_>, links: &[LinkView]) {
        for link in links {
            let lost = readings.growth(|it| it.ends(view, link).sent, |it| it.fates.dropped());
            self.lost_per_s = plus(self.lost_per_s, readings.per_s(lost));
            let ends = readings.now.ends(view, link);
            if ends.sent.is_some() && ends.taken.is_some() {
                let stalled = untaken(&ends).and_then(|it| it.too_long(readings.now.at()));
                let stalled_s = stalled.unwrap_or_default().as_secs_f64();
                self.stalled_s = larger(self.stalled_s, Some(stalled_s));
            }
        }
    }

    fn add(&mut self, more: &Self) {
        self.interfaces += more.interfaces;
        self.publishers += more.publishers;
        self.subscribers += more.subscribers;
        self.links += more.links;
        self.out_per_s = plus(self.out_per_s, more.out_per_s);
        self.out_bytes_per_s = plus(self.out_bytes_per_s, more.out_bytes_per_s);
        self.in_per_s = plus(self.in_per_s, more.in_per_s);
        self.in_bytes_per_s = plus(self.in_bytes_per_s, more.in_bytes_per_s);
        self.dropped = plus(self.dropped, more.dropped);
        self.lost = plus(self.lost, more.lost);
        self.lost_per_s = plus(self.lost_per_s, more.lost_per_s);
        self.missed_deadlines_per_s =
            plus(self.missed_deadlines_per_s, more.missed_deadlines_per_s);
        self.held = plus(self.held, more.held);
        self.stalled_s = larger(self.stalled_s, more.stalled_s);
        self.delay_ns = self.delay_ns.max(more.delay_ns);
        self.delay_is_new |= more.delay_is_new;
    }

    fn topic(&self, name: &str, data: Option<Type>) -> Vec<Cell> {
        let number = |value: f64| Cell::Number(Some(value));
        vec![
            Cell::Text(name.to_owned()),
            Cell::Type(data),
            number(f64::from(self.publishers)),
            number(f64::from(self.subscribers)),
            // Both ends of a link are interfaces of the topic, so each link was counted twice.
            number((self.links / 2) as f64),
            Cell::Number(self.out_per_s),
            Cell::Number(self.out_bytes_per_s.map(|bytes| bytes / 1e6)),
            match self.delay_ns.map(millis) {
                Some(delay_ms) if !self.delay_is_new => Cell::Old(delay_ms),
                delay_ms => Cell::Number(delay_ms),
            },
            Cell::Number(self.dropped),
            Cell::Number(self.lost),
            Cell::Number(self.lost_per_s),
            Cell::Number(self.missed_deadlines_per_s),
            Cell::Number(self.held),
            Cell::Number(self.stalled_s),
        ]
    }

    fn node(&self, name: &str, pid: i32, processor: Option<f64>) -> Vec<Cell> {
        let number = |value: f64| Cell::Number(Some(value));
        vec![
            Cell::Text(name.to_owned()),
            number(f64::from(pid)),
            Cell::Number(processor),
            number(f64::from(self.interfaces)),
            number(self.links as f64),
            Cell::Number(self.out_per_s),
            Cell::Number(self.out_bytes_per_s.map(|bytes| bytes / 1e6)),
            Cell::Number(self.in_per_s),
            Cell::Number(self.in_bytes_per_s.map(|bytes| bytes / 1e6)),
            Cell::Number(self.dropped),
            Cell::Number(self.lost),
            Cell::Number(self.lost_per_s),
            Cell::Number(self.missed_deadlines_per_s),
            Cell::Number(self.held),
            Cell::Number(self.stalled_s),
        ]
    }
}

/// The larger of those of the two that are known.
fn larger(one: Option<f64>, other: Option<f64>) -> Option<f64> {
    match (one, other) {
        (Some(one), Some(other)) => Some(one.max(other)),
        (known, None) | (None, known) => known,
    }
}

#[cfg(test)]
impl Figures {
    /// A topic and a node with figures as large as a busy robot has.
    pub(super) fn large() -> Self {
        let topic = Sums {
            publishers: 2,
            subscribers: 12,
            links: 48,
            out_per_s: Some(30_000.25),
            out_bytes_per_s: Some(745_700_000.0),
            delay_ns: Some(5_715_000),
            dropped: Some(1_234_567.0),
            lost: Some(98_765.0),
            lost_per_s: Some(1_234.5),
            missed_deadlines_per_s: Some(10.0),
            held: Some(16.0),
            stalled_s: Some(86_400.0),
            delay_is_new: true,
            ..Sums::default()
        };
        let node = Sums {
            interfaces: 14,
            in_per_s: Some(12_345.5),
            in_bytes_per_s: Some(1_234_567_890.0),
            ..topic
        };
        let data = sm2_proto::TypeId {
            name: Name::new("sensor/Image").unwrap(),
            hash: 1,
        };
        let topics = Table {
            columns: TOPICS,
            rows: vec![topic.topic("camera/front/image", Some(Type::from(&data)))],
        };
        let nodes = Table {
            columns: NODES,
            rows: vec![node.node("camera-driver", 1_234_567, Some(123.4))],
        };
        Self { topics, nodes }
    }
}
