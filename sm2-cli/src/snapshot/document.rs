//! The document of `sm2 snapshot`.

use serde::Serialize;
use sm2_proto::{Kind, control::Item, domain::LinkView, text::Counted};

use super::{
    gateways::{self, Gateway},
    named_item::{Link, NamedItem, Node, link_text},
};
use crate::{
    columns::{Column, Row, cell, number},
    connect::CommandNode,
    error::CliError,
    interfaces::InterfaceReport,
    limits::{self, LimitsInForce, Quota, quotas},
    observation::Readings,
    output::Output,
    sampling::{Sample, median_ns, millis},
    topic::Fates,
    troubles::LinkTroubles,
    view::View,
};

/// The object that `--json` prints. Field names are part of the command's interface.
#[derive(Serialize)]
pub(crate) struct Document {
    /// The Manager's epoch in hex digits. `None` if the Manager has ended since.
    epoch: Option<String>,
    revision: u64,
    limits: Option<LimitsInForce>,
    /// The troubles on all links.
    troubles: LinkTroubles,
    nodes: Vec<Node>,
    /// Includes refused interfaces.
    interfaces: Vec<InterfaceReport>,
    links: Vec<CountedLink>,
    /// Links that wait for room, claims, and pairs that match and are not linked.
    open: Vec<NamedItem>,
    quotas: Vec<Quota>,
    /// The names of nodes that keep no counters.
    without_counters: Vec<String>,
    gateways: Vec<Gateway>,
}

/// A link with the counters of both ends. An end whose node keeps no counters has `None`.
#[derive(Serialize)]
struct CountedLink {
    #[serde(flatten)]
    link: Link,
    counters: Option<Fates>,
    taken: Option<Taken>,
}

impl Row for CountedLink {
    const COLUMNS: &'static [Column<Self>] = &[
        ("OFFERING", |it| it.link.offering.clone()),
        ("DEMANDING", |it| it.link.demanding.clone()),
        ("TERMS", |it| it.link.terms().to_owned()),
        ("OFFERED", |it| cell(it.counters.map(|it| it.0.offered))),
        ("DELIVERED", |it| cell(it.counters.map(|it| it.0.delivered))),
        ("DROPPED", |it| cell(it.counters.map(|it| it.0.dropped()))),
        ("IN FLIGHT", |it| cell(it.counters.map(|it| it.0.in_flight))),
        ("LOST", |it| cell(it.taken.as_ref().map(|it| it.lost))),
        ("P50 ms", |it| {
            let delay = it.taken.as_ref().and_then(|it| it.delay_p50_ms);
            number(delay, 3)
        }),
    ];
}

/// The counters of the demanding side of a link.
#[derive(Serialize)]
struct Taken {
    messages: u64,
    bytes: u64,
    lost: u64,
    away: u64,
    /// The median of the last 32 delays. `None` for a service link: its ends measure no delays.
    delay_p50_ms: Option<f64>,
}

impl Document {
    pub(crate) fn new(
        command_node: &CommandNode,
        view: &View<'_>,
        readings: Readings<'_>,
        gateways: Vec<Gateway>,
    ) -> Self {
        let sample = readings.now;
        let itself = command_node.node.name();
        let items = view.domain.items();
        let mut document = Self {
            epoch: command_node.node.epoch().map(|epoch| format!("{epoch:x}")),
            revision: view.domain.revision(),
            limits: view.domain.limits().cloned().map(LimitsInForce),
            troubles: LinkTroubles::of_all(view, readings),
            nodes: Vec::new(),
            interfaces: Vec::new(),
            links: view
                .domain
                .links()
                .map(|it| counted(view, sample, &it))
                .collect(),
            open: Vec::new(),
            quotas: quotas(view),
            without_counters: Vec::new(),
            gateways,
        };
        for item in items.filter(|item| !matches!(item, Item::Link { .. })) {
            match NamedItem::new(view, item) {
                named if named.belongs_to(itself) => {}
                NamedItem::Node(node) => document.nodes.push(node),
                NamedItem::Interface(interface) => document.interfaces.push(interface),
                named @ (NamedItem::Waiting { .. }
                | NamedItem::Claim { .. }
                | NamedItem::Unlinked { .. }) => document.open.push(named),
                NamedItem::Domain(_) | NamedItem::Link(_) => {}
            }
        }
        let silent = sample.silent.iter().filter(|node| *node != itself);
        document.without_counters = silent.map(ToString::to_string).collect();
        document
    }

    /// # Errors
    ///
    /// [`CliError::Output`].
    pub(super) fn print(&self, out: &mut Output, shown: limits::Shown) -> Result<(), CliError> {
        let epoch = self.epoch.as_deref().unwrap_or("unknown");
        out.line(format_args!(
            "revision {} of epoch {epoch}: {}, {}, {}",
            self.revision,
            Counted::new(self.nodes.len() as u64, "node"),
            Counted::new(self.interfaces.len() as u64, "interface"),
            Counted::new(self.links.len() as u64, "link")
        ))?;
        // On a small screen, the first lines are those that a person sees.
        for line in self.troubles.lines() {
            out.sentence(&line)?;
        }
        for named in &self.open {
            out.line(named)?;
        }
        out.table_below(&self.links)?;
        out.table_below(&self.interfaces)?;
        out.table_below(&self.nodes)?;
        out.table_below(&gateways::rows(&self.gateways))?;
        let quotas = self.quotas.iter().filter(|it| shown.has(it)).cloned();
        out.table_below(&quotas.collect::<Vec<_>>())?;
        out.table_below(&limits::rows(self.limits.as_ref(), &self.quotas, shown))
    }
}

fn counted(view: &View<'_>, sample: &Sample, link: &LinkView) -> CountedLink {
    let taken = sample.demanding(view.domain, link);
    // A client is the sending side of a service link: it notes the times of its calls, not delays.
    let demanding = view.domain.interface(link.demanding);
    let is_subscriber = demanding.is_some_and(|it| it.contract.kind() == Kind::Subscriber);
    CountedLink {
        link: Link {
            link: link_text(link.link),
            offering: view.title(link.offering),
            demanding: view.title(link.demanding),
            version: link.version,
            reliable: link.reliable,
            sealed: link.sealed,
        },
        counters: sample
            .offering(view.domain, link)
            .map(|entry| Fates(entry.fates)),
        taken: taken.map(|entry| Taken {
            messages: entry.messages,
            bytes: entry.bytes,
            lost: entry.lost,
            away: entry.away,
            delay_p50_ms: median_ns(entry).filter(|_| is_subscriber).map(millis),
        }),
    }
}
