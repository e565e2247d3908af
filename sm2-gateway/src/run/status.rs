//! How a gateway is: for whoever asks the service `gateway/NAME/status` of its domain.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Duration,
};

use sm2_node::{Server, asynchronous::IntoAsync};
use sm2_proto::{
    Name,
    gateway::{Direction, GatewayId},
};
use tokio::{sync::oneshot, time::timeout};

use crate::{
    channel::{
        connection::ConnectionReport,
        hub::{HubHandle, HubStopped, PeerLookup},
    },
    hub::{Denial, PeerStatus},
    local::{Local, LocalError},
    names::status_service,
    peer::Me,
    question::{Availability, Question},
    report::{DenialReport, PeerReport, Report, ShadowReport, SubjectReport, label, word},
};

/// How long connections have to say how they are.
const PATIENCE: Duration = Duration::from_millis(250);

/// How long a peer has to answer a question.
const PEER_PATIENCE: Duration = Duration::from_secs(1);

/// A report to which the connections have not said their part.
#[derive(Debug)]
pub(super) struct Draft {
    pub(super) me: Me,
    /// Of the peers that are trusted.
    pub(super) names: BTreeMap<GatewayId, Name>,
    /// The line of each rule.
    pub(super) lines: Vec<usize>,
    pub(super) shadow: Option<Vec<ShadowReport>>,
    pub(super) peers: Vec<(PeerStatus, Option<oneshot::Receiver<ConnectionReport>>)>,
}

impl Draft {
    /// Waits for the connections, all at the same time, and answers.
    pub(super) async fn complete(self, answer: oneshot::Sender<Report>) {
        let connected: BTreeSet<GatewayId> = self.peers.iter().map(|(it, _)| it.id).collect();
        let absent = self.names.iter().filter(|(id, _)| !connected.contains(id));
        let mut report = Report {
            name: self.me.name.to_string(),
            id: self.me.hop.gateway.to_string(),
            peers: Vec::new(),
            absent: absent.map(|(_, name)| name.to_string()).collect(),
            shadow: self.shadow,
        };
        let deadline = tokio::time::Instant::now() + PATIENCE;
        for (status, said) in self.peers {
            let said = match said {
                Some(said) => {
                    let left = deadline.saturating_duration_since(tokio::time::Instant::now());
                    timeout(left, said).await.ok().and_then(Result::ok)
                }
                None => None,
            };
            report.peers.push(peer(status, said, &self.lines));
        }
        // Whoever asked may have gone.
        let _ = answer.send(report);
    }
}

fn peer(status: PeerStatus, said: Option<ConnectionReport>, lines: &[usize]) -> PeerReport {
    let mut messages = status.counts;
    let mut subjects = status.counts_by_name;
    if let Some(said) = &said {
        messages += said.counts;
        subjects.extend(said.counts_by_name.iter().cloned());
    }
    let mut by_name = BTreeMap::new();
    for (key, counts) in subjects {
        *by_name.entry(key).or_insert_with(Default::default) += counts;
    }
    let subjects = by_name
        .into_iter()
        .map(|((kind, name), counts)| SubjectReport {
            kind: word(kind).to_owned(),
            name: name.to_string(),
            counts,
        });
    let denials = status.denied.iter();
    let denials: Vec<_> = denials.map(|it| denial(it, lines)).collect();
    PeerReport {
        name: status.name.to_string(),
        id: status.id.to_string(),
        address: said.as_ref().map(|it| it.address.to_string()),
        rtt_ms: said.as_ref().map(|it| it.rtt.as_secs_f64() * 1e3),
        offers: status.offers.iter().map(label).collect(),
        offered: status.offered.iter().map(label).collect(),
        messages,
        subjects: subjects.collect(),
        denied: denials.len() as u64,
        denials,
    }
}

fn denial(it: &Denial, lines: &[usize]) -> DenialReport {
    DenialReport {
        kind: word(it.subject.kind()).to_owned(),
        name: it.subject.name().to_string(),
        direction: match it.direction {
            Direction::In => "in".to_owned(),
            Direction::Out => "out".to_owned(),
        },
        line: it.rule.and_then(|rule| lines.get(rule).copied()),
    }
}

/// Answers whoever asks, in JSON.
pub(super) fn serve(local: &Local, gateway: &Name, hub: HubHandle) -> Result<(), LocalError> {
    let service = status_service(gateway)?;
    let server: Server<[u8], [u8]> = local.node().server(service.as_str())?;
    let server = server.into_async()?;
    tokio::spawn(async move {
        loop {
            let request = match server.recv().await {
                Ok(request) => request,
                Err(error) => {
                    tracing::warn!(%error, "a question about the gateway was not taken");
                    continue;
                }
            };
            let hub = hub.clone();
            // A peer that is slow to answer keeps nobody else waiting.
            tokio::spawn(async move {
                let done = match answer(&hub, &request).await {
                    Ok(answer) => request.reply(&answer),
                    Err(reason) => request.fail(&reason),
                };
                if let Err(error) = done {
                    tracing::debug!(%error, "nobody waits for the answer any more");
                }
            });
        }
    });
    Ok(())
}

/// In JSON, or why there is none.
async fn answer(hub: &HubHandle, request: &[u8]) -> Result<Vec<u8>, String> {
    let ended = |error: HubStopped| error.to_string();
    let json = if request.is_empty() {
        let report = hub.report().await.map_err(ended)?;
        serde_json::to_vec(&report)
    } else {
        let question = serde_json::from_slice(request).map_err(|error| {
            format!("this is no question: {error}; an empty request is about all")
        })?;
        let available = availability(hub, question).await.map_err(ended)?;
        serde_json::to_vec(&available)
    };
    json.map_err(|error| error.to_string())
}

async fn availability(hub: &HubHandle, question: Question) -> Result<Availability, HubStopped> {
    Ok(match hub.ask_peer(question).await? {
        PeerLookup::Unknown => Availability::NoSuchPeer,
        PeerLookup::NotConnected => Availability::NotConnected,
        PeerLookup::Asked(verdict) => match timeout(PEER_PATIENCE, verdict).await {
            Ok(Ok(verdict)) => verdict.into(),
            Ok(Err(_)) | Err(_) => Availability::NoAnswer,
        },
    })
}
