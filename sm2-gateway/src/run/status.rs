//! Status reports, and the service `gateway/NAME/status` that gives them to the domain.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use sm2_node::{RecvError, Server, asynchronous::IntoAsync};
use sm2_proto::{
    Name,
    gateway::{Direction, GatewayId},
};
use tokio::{sync::oneshot, time::timeout};

use crate::{
    availability::{Availability, AvailabilityRequest},
    channel::{
        connection::ConnectionReport,
        hub::{HubHandle, HubStopped, PeerLookup},
    },
    hub::{Denial, PeerStatus},
    local::{Local, LocalError},
    names::status_service,
    peer::{Limits, Me},
    report::{
        DenialReport, PeerReport, Report, ShadowReport, SubjectReport, kind_name, subject_label,
    },
    retry::until_ok,
};

/// Timeout of the connections' part of a report.
const CONNECTION_TIMEOUT: Duration = Duration::from_millis(250);

/// Timeout of the answer of a peer.
const PEER_TIMEOUT: Duration = Duration::from_secs(1);

/// A report that lacks the parts of the connections.
#[derive(Debug)]
pub(super) struct PendingReport {
    pub(super) me: Me,
    /// The name of each trusted peer.
    pub(super) names: BTreeMap<GatewayId, Name>,
    /// The line of each rule.
    pub(super) rule_lines: Vec<usize>,
    pub(super) limits: Limits,
    /// The topics and services that peers want and the gateway has no room for.
    pub(super) waiting: Vec<String>,
    pub(super) shadow: Option<Vec<ShadowReport>>,
    pub(super) peers: Vec<(PeerStatus, Option<oneshot::Receiver<ConnectionReport>>)>,
}

impl PendingReport {
    /// Waits for all connections at the same time, then answers.
    pub(super) async fn complete(self, answer: oneshot::Sender<Report>) {
        let connected: BTreeSet<GatewayId> = self.peers.iter().map(|(it, _)| it.id).collect();
        let absent = self.names.iter().filter(|(id, _)| !connected.contains(id));
        let mut report = Report {
            name: self.me.name.to_string(),
            id: self.me.hop.gateway.to_string(),
            peers: Vec::new(),
            absent: absent.map(|(_, name)| name.to_string()).collect(),
            waiting: self.waiting,
            limits: self.limits,
            shadow: self.shadow,
        };
        let deadline = tokio::time::Instant::now() + CONNECTION_TIMEOUT;
        for (status, pending) in self.peers {
            let connection = match pending {
                Some(pending) => {
                    let left = deadline.saturating_duration_since(tokio::time::Instant::now());
                    timeout(left, pending).await.ok().and_then(Result::ok)
                }
                None => None,
            };
            report
                .peers
                .push(peer(status, connection, &self.rule_lines));
        }
        // The asker may have timed out.
        let _ = answer.send(report);
    }
}

fn peer(status: PeerStatus, connection: Option<ConnectionReport>, lines: &[usize]) -> PeerReport {
    let mut messages = status.counts;
    let mut subjects = status.counts_by_name;
    if let Some(connection) = &connection {
        messages += connection.counts;
        subjects.extend(connection.counts_by_name.iter().cloned());
    }
    let mut by_name = BTreeMap::new();
    for (key, counts) in subjects {
        *by_name.entry(key).or_insert_with(Default::default) += counts;
    }
    let subjects = by_name
        .into_iter()
        .map(|((kind, name), counts)| SubjectReport {
            kind: kind_name(kind).to_owned(),
            name: name.to_string(),
            counts,
        });
    let denials = status.denied.iter();
    let denials: Vec<_> = denials.map(|it| denial(it, lines)).collect();
    PeerReport {
        name: status.name.to_string(),
        id: status.id.to_string(),
        address: connection.as_ref().map(|it| it.address.to_string()),
        connected_s: connection
            .as_ref()
            .and_then(|it| it.age)
            .map(|it| (it.as_secs_f64() * 10.0).round() / 10.0),
        rtt_ms: connection.as_ref().map(|it| it.rtt.as_secs_f64() * 1e3),
        offers: status.offers.iter().map(subject_label).collect(),
        offered: status.offered.iter().map(subject_label).collect(),
        messages,
        subjects: subjects.collect(),
        denied: denials.len() as u64,
        denials,
    }
}

fn denial(it: &Denial, lines: &[usize]) -> DenialReport {
    DenialReport {
        kind: kind_name(it.subject.kind()).to_owned(),
        name: it.subject.name().to_string(),
        direction: match it.direction {
            Direction::In => "in".to_owned(),
            Direction::Out => "out".to_owned(),
        },
        line: it.rule.and_then(|rule| lines.get(rule).copied()),
    }
}

/// Declares the status service and starts the task that answers requests, in JSON.
pub(super) fn serve(local: &Local, gateway: &Name, hub: HubHandle) -> Result<(), LocalError> {
    let service = status_service(gateway)?;
    let server: Server<[u8], [u8]> = local.node().server(service.as_str())?;
    let server = server.into_async()?;
    tokio::spawn(async move {
        loop {
            let report = |error: &RecvError| tracing::warn!(%error, "cannot take a status request");
            let request = until_ok(|| server.recv(), report).await;
            let hub = hub.clone();
            // A task for each request, so that a slow peer delays no other request.
            tokio::spawn(async move {
                let done = match answer(&hub, &request).await {
                    Ok(answer) => request.reply(&answer),
                    Err(error) => request.fail(&error.to_string()),
                };
                if let Err(error) = done {
                    tracing::debug!(%error, "the caller did not wait for the status");
                }
            });
        }
    });
    Ok(())
}

/// Why a status request failed.
#[derive(Debug, thiserror::Error)]
enum StatusError {
    #[error("the request is not valid: {0}; an empty request is answered with a report")]
    Request(serde_json::Error),
    #[error("cannot encode the answer: {0}")]
    Answer(serde_json::Error),
    #[error(transparent)]
    Stopped(#[from] HubStopped),
}

/// The answer in JSON.
async fn answer(hub: &HubHandle, request: &[u8]) -> Result<Vec<u8>, StatusError> {
    let json = if request.is_empty() {
        let report = hub.report().await?;
        serde_json::to_vec(&report)
    } else {
        let request = serde_json::from_slice(request).map_err(StatusError::Request)?;
        let available = availability(hub, request).await?;
        serde_json::to_vec(&available)
    };
    json.map_err(StatusError::Answer)
}

async fn availability(
    hub: &HubHandle,
    request: AvailabilityRequest,
) -> Result<Availability, HubStopped> {
    Ok(match hub.ask_peer(request).await? {
        PeerLookup::Unknown => Availability::NoSuchPeer,
        PeerLookup::NotConnected => Availability::NotConnected,
        PeerLookup::Asked(verdict) => match timeout(PEER_TIMEOUT, verdict).await {
            Ok(Ok(verdict)) => verdict.into(),
            Ok(Err(_)) | Err(_) => Availability::NoAnswer,
        },
    })
}

#[cfg(test)]
mod tests {
    use sm2_proto::gateway::Hop;
    use tokio::time::sleep;

    use super::*;
    use crate::{peer::ConnectionId, tally::Counts};

    fn status(number: u8) -> PeerStatus {
        PeerStatus {
            id: GatewayId([number; 32]),
            name: Name::new(&format!("peer{number}")).unwrap(),
            connection: ConnectionId(number.into()),
            epoch: 1,
            offers: Vec::new(),
            offered: Vec::new(),
            denied: Vec::new(),
            counts: Counts::default(),
            counts_by_name: Vec::new(),
        }
    }

    /// Two connections have nearly all of the time, one takes longer, and a fourth one has ended.
    #[tokio::test(start_paused = true)]
    async fn a_report_waits_a_quarter_of_a_second_for_all_connections_together() {
        let mut peers = Vec::new();
        for (number, late_ms) in [(1, 240), (2, 240), (3, 260)] {
            let (answer, pending) = oneshot::channel();
            peers.push((status(number), Some(pending)));
            tokio::spawn(async move {
                sleep(Duration::from_millis(late_ms)).await;
                let report = ConnectionReport {
                    counts: Counts::ALL_DIFFERENT,
                    counts_by_name: Vec::new(),
                    age: Some(Duration::from_secs(60)),
                    rtt: Duration::from_micros(2_500),
                    address: ([127, 0, 0, 1], 7_633).into(),
                };
                // The report may be complete already.
                let _ = answer.send(report);
            });
        }
        peers.push((status(4), None));
        let names = (1..=5).map(|it| (status(it).id, status(it).name));
        let pending = PendingReport {
            me: Me {
                hop: Hop {
                    gateway: GatewayId([9; 32]),
                    epoch: 1,
                },
                name: Name::new("me").unwrap(),
            },
            names: names.collect(),
            rule_lines: Vec::new(),
            limits: Limits::default(),
            waiting: Vec::new(),
            shadow: None,
            peers,
        };
        let (answer, answered) = oneshot::channel();
        pending.complete(answer).await;
        let report = answered.await.unwrap();
        assert_eq!(report.absent, ["peer5"]);
        let parts = report.peers.iter().map(|it| (&*it.name, it.rtt_ms));
        let rtt_ms = Some(2.5);
        assert!(parts.eq([
            ("peer1", rtt_ms),
            ("peer2", rtt_ms),
            ("peer3", None),
            ("peer4", None)
        ]));
        assert_eq!(report.peers[0].messages, Counts::ALL_DIFFERENT);
        assert_eq!(report.peers[2].messages, Counts::default());
    }
}
