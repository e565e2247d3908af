//! The tables of `sm2 top`: the figures of topics and nodes in the last interval.

use std::collections::BTreeMap;

use serde::Serialize;
use serde_json::{Map, Value};
use sm2_proto::{Contract, Kind, Name, NodeId, domain::InterfaceView};

use crate::{
    sampling::{Sample, hundredths, median_ns, millis},
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

/// A table whose first column is the name.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Table {
    pub(super) columns: &'static [Column],
    pub(super) rows: Vec<Vec<Cell>>,
}

/// A column of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Column {
    pub(super) heading: &'static str,
    /// Its name in JSON.
    key: &'static str,
    /// The number of decimals that its numbers have.
    decimals: usize,
    /// On a narrow screen, the column with the lowest rank is left out first. See [`HELP`](super::HELP).
    pub(super) rank: u8,
    /// Whether its numbers are messages per second, which the sparkline adds up.
    is_rate: bool,
    /// Whether a number above 0 asks for attention.
    pub(super) is_loss: bool,
}

/// A cell.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Cell {
    Text(String),
    /// `None` if the number is not known.
    Number(Option<f64>),
}

const fn column(heading: &'static str, key: &'static str, decimals: usize, rank: u8) -> Column {
    Column {
        heading,
        key,
        decimals,
        rank,
        is_rate: false,
        is_loss: false,
    }
}

const fn rate(heading: &'static str, key: &'static str, rank: u8) -> Column {
    Column {
        is_rate: true,
        ..column(heading, key, 2, rank)
    }
}

const fn loss(heading: &'static str, key: &'static str, rank: u8) -> Column {
    Column {
        is_loss: true,
        ..column(heading, key, 0, rank)
    }
}

/// The rank of a table's first column, which is never left out.
const NAME: u8 = u8::MAX;

const TOPICS: &[Column] = &[
    column("TOPIC", "name", 0, NAME),
    column("TYPE", "type", 0, 0),
    column("PUBS", "publishers", 0, 2),
    column("SUBS", "subscribers", 0, 3),
    column("LINKS", "links", 0, 1),
    rate("HZ", "hz", 8),
    column("MB/s", "mb_per_s", 3, 6),
    column("P50 ms", "delay_p50_ms", 3, 5),
    loss("DROPPED", "dropped", 4),
    loss("LOST", "lost", 7),
];

const NODES: &[Column] = &[
    column("NODE", "name", 0, NAME),
    column("PID", "pid", 0, 2),
    column("IFACES", "interfaces", 0, 0),
    column("LINKS", "links", 0, 1),
    rate("OUT/s", "out_per_s", 8),
    column("OUT MB/s", "out_mb_per_s", 3, 5),
    rate("IN/s", "in_per_s", 7),
    column("IN MB/s", "in_mb_per_s", 3, 4),
    loss("DROPPED", "dropped", 3),
    loss("LOST", "lost", 6),
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
    /// The largest median delay of all links.
    delay_ns: Option<u64>,
}

impl Figures {
    /// The figures of the time between two samples, without the node `itself`.
    pub(super) fn new(view: &View<'_>, before: &Sample, now: &Sample, itself: &Name) -> Self {
        let mut topics: BTreeMap<&Name, Sums> = BTreeMap::new();
        let mut nodes: BTreeMap<NodeId, Sums> = BTreeMap::new();
        for it in view.granted() {
            let sums = sums(view, before, now, it);
            if matches!(it.contract.kind(), Kind::Publisher | Kind::Subscriber) {
                topics.entry(it.contract.name()).or_default().add(&sums);
            }
            nodes.entry(it.entity.node).or_default().add(&sums);
        }
        let topics = topics.into_iter().map(|(name, sums)| {
            let data = view.topic_type(name);
            let data = data.map_or("-", |data| data.name.as_str());
            sums.topic(name.as_str(), data)
        });
        let others = view.domain.nodes().filter(|node| node.name != itself);
        let nodes = others.map(|node| {
            let sums = nodes.get(&node.node).copied().unwrap_or_default();
            sums.node(node.name.as_str(), node.pid)
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
    pub(crate) fn new(
        view: &View<'_>,
        before: &Sample,
        now: &Sample,
        it: InterfaceView<'_>,
    ) -> Self {
        Self {
            node_id: it.entity.node.0,
            interface: it.entity.interface.0,
            sums: sums(view, before, now, it),
        }
    }
}

/// The figures of one interface.
fn sums(view: &View<'_>, before: &Sample, now: &Sample, it: InterfaceView<'_>) -> Sums {
    let domain = view.domain;
    let links = view.links_of(it.entity);
    let rate = now.rate(before, domain, it.entity);
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
            sums.delay_ns = ends.filter_map(median_ns).max();
        }
        Kind::Server | Kind::Client => {}
    }
    sums
}

impl Sums {
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
        self.delay_ns = self.delay_ns.max(more.delay_ns);
    }

    fn topic(&self, name: &str, data: &str) -> Vec<Cell> {
        let number = |value: f64| Cell::Number(Some(value));
        vec![
            Cell::Text(name.to_owned()),
            Cell::Text(data.to_owned()),
            number(f64::from(self.publishers)),
            number(f64::from(self.subscribers)),
            // Both ends of a link are interfaces of the topic, so each link was counted twice.
            number((self.links / 2) as f64),
            Cell::Number(self.out_per_s),
            Cell::Number(self.out_bytes_per_s.map(|bytes| bytes / 1e6)),
            Cell::Number(self.delay_ns.map(millis)),
            Cell::Number(self.dropped),
            Cell::Number(self.lost),
        ]
    }

    fn node(&self, name: &str, pid: i32) -> Vec<Cell> {
        let number = |value: f64| Cell::Number(Some(value));
        vec![
            Cell::Text(name.to_owned()),
            number(f64::from(pid)),
            number(f64::from(self.interfaces)),
            number(self.links as f64),
            Cell::Number(self.out_per_s),
            Cell::Number(self.out_bytes_per_s.map(|bytes| bytes / 1e6)),
            Cell::Number(self.in_per_s),
            Cell::Number(self.in_bytes_per_s.map(|bytes| bytes / 1e6)),
            Cell::Number(self.dropped),
            Cell::Number(self.lost),
        ]
    }
}

/// The sum of those of the two that are known.
fn plus(one: Option<f64>, other: Option<f64>) -> Option<f64> {
    match (one, other) {
        (Some(one), Some(other)) => Some(one + other),
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
            ..Sums::default()
        };
        let node = Sums {
            interfaces: 14,
            in_per_s: Some(12_345.5),
            in_bytes_per_s: Some(1_234_567_890.0),
            ..topic
        };
        let topics = Table {
            columns: TOPICS,
            rows: vec![topic.topic("camera/front/image", "sensor/Image")],
        };
        let nodes = Table {
            columns: NODES,
            rows: vec![node.node("camera-driver", 1_234_567)],
        };
        Self { topics, nodes }
    }
}

impl Table {
    /// The messages per second of a row, in all its directions. `None` if they are not known.
    pub(super) fn rate(&self, row: &[Cell]) -> Option<f64> {
        let rates = self.columns.iter().zip(row).filter(|(it, _)| it.is_rate);
        rates.fold(None, |sum, (_, cell)| match cell {
            Cell::Number(number) => plus(sum, *number),
            Cell::Text(_) => sum,
        })
    }

    fn json(&self) -> Value {
        let row = |row: &Vec<Cell>| {
            let members = self.columns.iter().zip(row).map(|(column, cell)| {
                let value = match cell {
                    Cell::Text(text) => Value::from(text.as_str()),
                    Cell::Number(Some(number)) if column.decimals == 0 => {
                        Value::from(number.round() as i64)
                    }
                    Cell::Number(Some(number)) if column.decimals == 2 => {
                        Value::from(hundredths(*number))
                    }
                    Cell::Number(number) => Value::from(*number),
                };
                (column.key.to_owned(), value)
            });
            Value::Object(members.collect::<Map<_, _>>())
        };
        self.rows.iter().map(row).collect()
    }
}

impl Column {
    #[cfg(test)]
    pub(super) const fn test(heading: &'static str, decimals: usize) -> Self {
        Self {
            is_rate: true,
            ..column(heading, heading, decimals, NAME)
        }
    }

    /// A cell of this column as text.
    pub(super) fn show(&self, cell: &Cell) -> String {
        match cell {
            Cell::Text(text) => text.clone(),
            Cell::Number(Some(number)) => format!("{number:.*}", self.decimals),
            Cell::Number(None) => "-".into(),
        }
    }
}

impl Cell {
    pub(super) fn as_text(&self) -> &str {
        match self {
            Self::Text(text) => text,
            Self::Number(_) => "",
        }
    }

    /// Orders numbers from the largest to the smallest, unknown ones last, and texts alphabetically.
    pub(super) fn order(&self, other: &Self) -> std::cmp::Ordering {
        match (self, other) {
            (Self::Text(one), Self::Text(other)) => one.cmp(other),
            (Self::Number(one), Self::Number(other)) => {
                let value = |it: &Option<f64>| it.unwrap_or(f64::NEG_INFINITY);
                value(other).total_cmp(&value(one))
            }
            (Self::Text(_), Self::Number(_)) => std::cmp::Ordering::Less,
            (Self::Number(_), Self::Text(_)) => std::cmp::Ordering::Greater,
        }
    }
}
