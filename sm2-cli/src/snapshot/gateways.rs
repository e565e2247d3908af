//! The reports of a domain's gateways.

use std::time::Duration;

use serde::Serialize;
use sm2_gateway::{Counts, Report, report};
use sm2_proto::domain::Domain as Mirror;

use crate::{
    columns::{Column, Row, cell, number},
    connect::CommandNode,
};

/// The timeout for the answers of all gateways together.
const TIMEOUT: Duration = Duration::from_secs(1);

/// A gateway and its report.
#[derive(Serialize)]
pub(crate) struct Gateway {
    /// The service that gives the report.
    service: String,
    /// `None` if the gateway did not answer in time.
    report: Option<Report>,
    /// The reason why there is no report.
    error: Option<String>,
}

/// Asks the gateways of a domain. The result includes those that do not answer.
pub(crate) fn ask(command_node: &CommandNode, domain: &Mirror) -> Vec<Gateway> {
    let services = report::gateways(domain);
    let answers = report::ask(&command_node.node, services, TIMEOUT).into_iter();
    let gateways = answers.map(|(service, report)| {
        let (report, error) = match report {
            Ok(report) => (Some(report), None),
            Err(error) => (None, Some(error.to_string())),
        };
        Gateway {
            service: service.to_string(),
            report,
            error,
        }
    });
    gateways.collect()
}

/// A line for each gateway and each peer.
pub(crate) fn lines(gateways: &[Gateway]) -> Vec<String> {
    let mut lines = Vec::new();
    for gateway in gateways {
        let Some(report) = &gateway.report else {
            let error = gateway.error.as_deref().unwrap_or("no report");
            lines.push(format!("{}: {error}", gateway.service));
            continue;
        };
        let peers = report.peers.iter();
        let peers = peers.map(|peer| {
            let Counts {
                sent,
                received,
                lost,
                ..
            } = peer.messages;
            let rtt = peer
                .rtt_ms
                .map_or_else(String::new, |rtt| format!(", RTT {rtt:.1} ms"));
            let name = &peer.name;
            format!(
                "{name}: sent {sent}, received {received}, lost {lost}, denied {}{rtt}",
                peer.denied
            )
        });
        let absent = report
            .absent
            .iter()
            .map(|peer| format!("{peer}: not connected"));
        let before = lines.len();
        lines.extend(
            peers
                .chain(absent)
                .map(|line| format!("{}, peer {line}", report.name)),
        );
        if lines.len() == before {
            lines.push(format!("{}: no peers", report.name));
        }
    }
    lines
}

/// A row for people: a peer of a gateway, or a topic or service of the peer.
pub(super) struct PeerRow {
    gateway: String,
    peer: String,
    of: String,
    counts: Option<Counts>,
    denied: Option<u64>,
    rtt_ms: Option<f64>,
}

impl Row for PeerRow {
    const COLUMNS: &'static [Column<Self>] = &[
        ("GATEWAY", |it| it.gateway.clone()),
        ("PEER", |it| it.peer.clone()),
        ("OF", |it| it.of.clone()),
        ("OFFERED", |it| cell(it.counts.map(|it| it.offered))),
        ("SENT", |it| cell(it.counts.map(|it| it.sent))),
        ("SUPERSEDED", |it| cell(it.counts.map(|it| it.superseded))),
        ("EXPIRED", |it| cell(it.counts.map(|it| it.expired))),
        ("RECEIVED", |it| cell(it.counts.map(|it| it.received))),
        ("LOST", |it| cell(it.counts.map(|it| it.lost))),
        ("DENIED", |it| cell(it.denied)),
        ("RTT ms", |it| number(it.rtt_ms, 1)),
    ];
}

impl PeerRow {
    /// A row without figures.
    fn new(gateway: &str, peer: &str, of: impl Into<String>) -> Self {
        Self {
            gateway: gateway.to_owned(),
            peer: peer.to_owned(),
            of: of.into(),
            counts: None,
            denied: None,
            rtt_ms: None,
        }
    }
}

/// A row for each peer, and for each topic and service of the peer.
pub(super) fn rows(gateways: &[Gateway]) -> Vec<PeerRow> {
    let mut rows = Vec::new();
    for gateway in gateways {
        let Some(report) = &gateway.report else {
            rows.push(PeerRow::new(&gateway.service, "-", "does not answer"));
            continue;
        };
        if report.peers.is_empty() && report.absent.is_empty() {
            rows.push(PeerRow::new(&report.name, "-", "no peers"));
        }
        for peer in &report.peers {
            rows.push(PeerRow {
                counts: Some(peer.messages),
                denied: Some(peer.denied),
                rtt_ms: peer.rtt_ms,
                ..PeerRow::new(&report.name, &peer.name, "all")
            });
            rows.extend(peer.subjects.iter().map(|it| PeerRow {
                counts: Some(it.counts),
                ..PeerRow::new(&report.name, &peer.name, format!("{} {}", it.kind, it.name))
            }));
        }
        let absent = report.absent.iter();
        rows.extend(absent.map(|peer| PeerRow::new(&report.name, peer, "not connected")));
    }
    rows
}
