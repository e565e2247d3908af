//! The document of `sm2 snapshot`.

use serde::Serialize;
use sm2_proto::{Kind, control::Item, domain::LinkView, text::Counted};

use super::{
    gateways::{self, Gateway},
    named_item::{Link, NamedItem, Node, link_text},
};
use crate::{
    columns::Columns,
    connect::CommandNode,
    error::CliError,
    interfaces::{self, InterfaceReport},
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
    pub(super) fn print(&self, out: &mut Output, limits: limits::Shown) -> Result<(), CliError> {
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
        if !self.links.is_empty() {
            out.line(format_args!("\n{}", self.links_table()))?;
        }
        if !self.interfaces.is_empty() {
            out.line(format_args!("\n{}", interfaces::table(&self.interfaces)))?;
        }
        if !self.nodes.is_empty() {
            out.line(format_args!("\n{}", self.nodes_table()))?;
        }
        if !self.gateways.is_empty() {
            out.line(format_args!("\n{}", gateways::table(&self.gateways)))?;
        }
        self.print_limits(out, limits)
    }

    fn print_limits(&self, out: &mut Output, shown: limits::Shown) -> Result<(), CliError> {
        let quotas: Vec<_> = self.quotas.iter().filter(|it| shown.has(it)).collect();
        if !quotas.is_empty() {
            let mut table = Columns::new(["QUOTA OF", "WHAT", "USED", "LIMIT"]);
            for quota in quotas {
                table.push([
                    quota.of.clone(),
                    quota.quota.into(),
                    quota.used.to_string(),
                    quota.limit.to_string(),
                ]);
            }
            out.line(format_args!("\n{table}"))?;
        }
        let limits = self.limits.as_ref();
        match limits.and_then(|it| limits::table(it, &self.quotas, shown)) {
            Some(table) => out.line(format_args!("\n{table}")),
            None => Ok(()),
        }
    }

    fn nodes_table(&self) -> Columns<5> {
        let mut table = Columns::new(["NODE", "ID", "UID", "PID", "STATE"]);
        for node in &self.nodes {
            table.push([
                node.name.clone(),
                node.id.to_string(),
                node.uid.to_string(),
                node.pid.to_string(),
                if node.resuming { "resuming" } else { "ready" }.into(),
            ]);
        }
        table
    }

    fn links_table(&self) -> Columns<9> {
        let mut table = Columns::new([
            "OFFERING",
            "DEMANDING",
            "TERMS",
            "OFFERED",
            "DELIVERED",
            "DROPPED",
            "IN FLIGHT",
            "LOST",
            "P50 ms",
        ]);
        let number = |value: Option<u64>| value.map_or_else(|| "-".into(), |it| it.to_string());
        for CountedLink {
            link,
            counters,
            taken,
        } in &self.links
        {
            let terms = match (link.reliable, link.sealed) {
                (false, false) => "best effort",
                (true, false) => "reliable",
                (false, true) => "sealed",
                (true, true) => "reliable, sealed",
            };
            let delay = taken.as_ref().and_then(|it| it.delay_p50_ms);
            table.push([
                link.offering.clone(),
                link.demanding.clone(),
                terms.into(),
                number(counters.map(|it| it.0.offered)),
                number(counters.map(|it| it.0.delivered)),
                number(counters.map(|it| it.0.dropped())),
                number(counters.map(|it| it.0.in_flight)),
                number(taken.as_ref().map(|it| it.lost)),
                delay.map_or_else(|| "-".into(), |delay| format!("{delay:.3}")),
            ]);
        }
        table
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
