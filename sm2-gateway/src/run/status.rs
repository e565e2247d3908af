//! How a gateway is: for whoever asks the service `gateway/NAME/status` of its domain.

use serde::{Deserialize, Serialize};
use sm2_node::{Server, asynchronous::IntoAsync};
use sm2_proto::Name;
use tokio::sync::{mpsc, oneshot};

use super::{
    Message,
    connection::{Shared, lock},
    label,
};
use crate::{
    hub::Hub,
    local::{Local, LocalError, status_service},
    peer::Counts,
};

/// How a gateway is.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct Report {
    /// What people call it.
    pub name: String,
    /// Who it is.
    pub id: String,
    /// The peers that there is a connection with.
    pub peers: Vec<PeerReport>,
}

/// A peer that there is a connection with.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub struct PeerReport {
    /// What the configuration calls it.
    pub name: String,
    /// Who it is.
    pub id: String,
    /// Where it is.
    pub address: String,
    /// The time that it takes there and back, in milliseconds.
    pub rtt_ms: f64,
    /// What it offers.
    pub offers: Vec<String>,
    /// What it was offered.
    pub offered: Vec<String>,
    /// Messages: for it, and from it.
    pub messages: Counts,
}

pub(super) fn report(hub: &Hub, shared: &Shared) -> Report {
    let reports = lock(&shared.reports);
    let peer = |it: crate::hub::PeerStatus| {
        let report = reports.get(&it.connection);
        PeerReport {
            name: it.name.to_string(),
            id: it.id.to_string(),
            address: report.map_or_else(String::new, |it| it.address.to_string()),
            rtt_ms: report.map_or(0.0, |it| it.rtt.as_secs_f64() * 1e3),
            offers: it.offers.iter().map(label).collect(),
            offered: it.offered.iter().map(label).collect(),
            messages: report.map_or_else(Counts::default, |it| it.counts),
        }
    };
    Report {
        name: shared.me.name.to_string(),
        id: shared.me.hop.gateway.to_string(),
        peers: hub.peers().into_iter().map(peer).collect(),
    }
}

/// Answers whoever asks, in JSON.
pub(super) fn serve(
    local: &Local,
    gateway: &Name,
    hub: mpsc::Sender<Message>,
) -> Result<(), LocalError> {
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
            let (answer, answered) = oneshot::channel();
            if hub.send(Message::Report(answer)).await.is_err() {
                return;
            }
            let Ok(report) = answered.await else { return };
            let done = match serde_json::to_vec(&report) {
                Ok(report) => request.reply(&report),
                Err(error) => request.fail(&error.to_string()),
            };
            if let Err(error) = done {
                tracing::debug!(%error, "nobody waits for the report any more");
            }
        }
    });
    Ok(())
}
