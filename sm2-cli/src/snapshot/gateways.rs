//! The reports of a domain's gateways.

use std::time::Duration;

use serde::Serialize;
use sm2_gateway::{
    Counts, Report,
    report::{self, PeerReport},
};
use sm2_proto::domain::Domain as Mirror;

use crate::{columns::Columns, connect::CommandNode};

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

/// A table for people: a line for each peer, and for each topic and service of the peer.
pub(super) fn table(gateways: &[Gateway]) -> Columns<11> {
    let mut table = Columns::new([
        "GATEWAY",
        "PEER",
        "OF",
        "OFFERED",
        "SENT",
        "SUPERSEDED",
        "EXPIRED",
        "RECEIVED",
        "LOST",
        "DENIED",
        "RTT ms",
    ]);
    for gateway in gateways {
        let Some(report) = &gateway.report else {
            table.push(row(&gateway.service, "-", "does not answer", None, None));
            continue;
        };
        if report.peers.is_empty() && report.absent.is_empty() {
            table.push(row(&report.name, "-", "no peers", None, None));
        }
        for peer in &report.peers {
            table.push(row(
                &report.name,
                &peer.name,
                "all",
                Some(&peer.messages),
                Some(peer),
            ));
            for it in &peer.subjects {
                let of = format!("{} {}", it.kind, it.name);
                table.push(row(&report.name, &peer.name, &of, Some(&it.counts), None));
            }
        }
        for peer in &report.absent {
            table.push(row(&report.name, peer, "not connected", None, None));
        }
    }
    table
}

fn row(
    gateway: &str,
    name: &str,
    of: &str,
    counts: Option<&Counts>,
    peer: Option<&PeerReport>,
) -> [String; 11] {
    let number = |count: fn(&Counts) -> u64| {
        counts.map_or_else(|| "-".to_owned(), |it| count(it).to_string())
    };
    let rtt = peer.and_then(|it| it.rtt_ms);
    [
        gateway.to_owned(),
        name.to_owned(),
        of.to_owned(),
        number(|it| it.offered),
        number(|it| it.sent),
        number(|it| it.superseded),
        number(|it| it.expired),
        number(|it| it.received),
        number(|it| it.lost),
        peer.map_or_else(|| "-".to_owned(), |it| it.denied.to_string()),
        rtt.map_or_else(|| "-".to_owned(), |it| format!("{it:.1}")),
    ]
}
